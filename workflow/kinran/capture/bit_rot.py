"""Verify the frames of captures: hash them all, and compare with the journal and the manifests."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError, read_as, sha256
from kinran.base.log import progress
from kinran.capture.brackets_taken import frame_place
from kinran.capture.journal import JOURNAL, read, remedy, running
from kinran.capture.lost_records import checked_brackets
from kinran.capture.sidecar import read_sidecars
from kinran.capture.store import UNRECORDED


@dataclass(frozen=True)
class _Entry:
    """A frame in a manifest."""

    file: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class _Shot:
    shot: str
    frames: tuple[_Entry, ...]


@dataclass(frozen=True)
class _Manifest:
    kind: str
    group: str
    shots: tuple[_Shot, ...]


def verify(root: Path) -> tuple[int, list[str]]:
    """Hash the frames of a capture, and compare them with its journal and manifests.

    Parameters
    ----------
    root
        Folder of the capture.

    Returns
    -------
    int
        Number of files whose digests were compared.
    list
        What is wrong, a sentence for each file.

    Raises
    ------
    InputError
        There is no such capture, a capture of it is running, or a manifest is broken.
    """
    journal = root / JOURNAL
    manifests = sorted((root / "groups").glob("*.json"))
    if not journal.exists() and not manifests:
        raise InputError(f"{root}: has neither a journal nor manifests; give the name of a fabric under captures/")
    if journal.exists() and running(journal):
        raise InputError(f"{journal}: a capture of this fabric is running; wait for its end")
    wanted, wrong = _journalled(root)
    stale = dict(wanted)
    for path in manifests:
        for file, digest in _listed(path):
            if stale.setdefault(file, digest) != digest and frame_place(file):
                wrong.append(f"{path}: names other bytes of {file} than the journal; make it anew")
            wanted.setdefault(file, digest)
    for file, digest in progress(wanted.items(), root.name, "frames hashed", len(wanted)):
        if said := _compared(root / file, digest):
            wrong.append(said)
    wrong += [f"{path}: is no frame that the journal or a manifest knows" for path in _extra(root, set(wanted))]
    return len(wanted), wrong


def _journalled(root: Path) -> tuple[dict[str, str], list[str]]:
    """Return the digests by file that the journal names, and what is wrong with the journal and the sidecars."""
    wanted: dict[str, str] = {}
    if not (root / JOURNAL).exists():
        return wanted, [f"{root / JOURNAL}: is missing; {remedy(root)}"] if (root / "frames").is_dir() else []
    try:
        records, _ = read(root / JOURNAL)
        brackets = checked_brackets(root, records)
    except InputError as error:
        return wanted, [str(error)]
    for number, bracket in enumerate(brackets):
        for frame in bracket.frames.values():
            moved = f"superseded/{number}/{Path(frame['file']).name}"
            if not bracket.void:
                wanted[frame["file"]] = frame["sha256"]
            elif (root / moved).exists():
                wanted[moved] = frame["sha256"]
    for record in records:
        if record["t"] == "quarantined":
            wanted |= {file["file"]: file["sha256"] for file in record["files"]}
    return wanted, [f"{path}: is a damaged sidecar; {remedy(root)}" for path in read_sidecars(root)[1]]


def _listed(manifest: Path) -> Iterator[tuple[str, str]]:
    """Yield file and digest of each frame of a manifest."""
    for shot in read_as(manifest, _Manifest, "a manifest", "capture the group again").shots:
        for frame in shot.frames:
            yield frame.file, frame.sha256


def _compared(path: Path, digest: str) -> str:
    """Return what is wrong with a file; nothing where its digest is right."""
    try:
        found = sha256(path)
    except FileNotFoundError:
        return f"{path}: is missing"
    except OSError as error:
        return f"{path}: cannot be read ({error.strerror})"
    return "" if found == digest else f"{path}: has other bytes than were recorded"


def _extra(root: Path, wanted: set[str]) -> Iterator[Path]:
    """Yield files in the folders of the capture that nothing names, and that do not bear their own digest as name."""
    for folder in ("frames", "quarantine", "superseded"):
        for path in sorted((root / folder).rglob("*")):
            known = path.suffix in (".jsonl", ".damaged") or path.relative_to(root).as_posix() in wanted
            named_so = path.parent.name in (UNRECORDED, "quarantine") and path.is_file() and not known
            if path.is_file() and not known and not (named_so and sha256(path)[:12] == path.name[:12]):
                yield path


def verify_all(roots: Sequence[Path]) -> None:
    """Verify captures, and print what is wrong.

    Raises
    ------
    InputError
        A file is damaged, missing, or known to nobody.
    """
    if not roots:
        raise InputError("captures: has no capture; run this in the folder of the project")
    bad = []
    for root in roots:
        count, wrong = verify(root)
        for said in wrong:
            print(said)
        if wrong:
            bad.append(f"{root.name} has faults (files: {count}, faults: {len(wrong)}): {remedies(root)}")
        else:
            print(f"{root.name}: {count} files are as they were recorded")
    if bad:
        raise InputError("; ".join(bad))


def remedies(root: Path) -> str:
    """Return the commands after which what is wrong with a capture is shot, or taken in, again."""
    if (root / "frames").is_dir():
        return f"{remedy(root)}, then capture its groups again (`snakemake --force {root}/groups/GROUP.json`)"
    return f"put the photographs back, or take them in again (`snakemake --force {root}/groups/GROUP.json`)"
