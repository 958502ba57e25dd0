"""Damage of files: each file of a fabric against its checksum, with the job that makes it again.

What carries a checksum carries it inside: chunks of the stack (CRC-32C), EXR, JSON, meshes, scenes and pages (CRC-32),
PNG and .npz (CRC-32 of their formats). SHA-256 of frames stand in the manifests, those of shards in the receipts.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from kinran.base.checksums import JSON_LINE, MARK
from kinran.base.exr import CRC32, read_exr_with_header
from kinran.base.files import InputError, check_comment, read_as, read_json, sha256
from kinran.base.npz import read_npz
from kinran.base.pictures import check_png
from kinran.capture import bit_rot
from kinran.data.capture_plan import read_plan
from kinran.data.radiance_stack import Stack
from kinran.data.shards import NAMES, SHARD, check_receipt, shard_path

MADE_WITH = {
    "texture.exr": "scene.xml",
    "fitted.exr": "scene.xml",
}
"""Files that a rule does not name among its outputs, and the output beside them whose job makes them."""


@dataclass(frozen=True)
class Fault:
    """What is wrong with a file, and how it is mended.

    Attributes
    ----------
    says
        Sentence that names the file.
    forced
        Output of a rule whose job makes the file again with ``snakemake --forcerun``; None where none does.
    removed
        File to remove first, so that Snakemake sees that its job must run; None where none must be.
    """

    says: str
    forced: Path | None = None
    removed: Path | None = None


@dataclass(frozen=True)
class Checked:
    """A file that was looked at: its fault, or whether it has a checksum at all."""

    path: Path
    fault: Fault | None = None
    has_checksum: bool = True


@dataclass(frozen=True)
class _Frame:
    file: str
    sha256: str


@dataclass(frozen=True)
class _Shot:
    frames: tuple[_Frame, ...]


@dataclass(frozen=True)
class _Manifest:
    kind: str
    shots: tuple[_Shot, ...]


def check_capture(folder: Path) -> Iterator[Checked]:
    """Check plan, journal, manifests and frames of a capture."""
    plan, journal = folder / "plan.json", folder / "journal.jsonl"
    if plan.is_file():
        yield _checked(plan, lambda path: read_plan(path) and _states_json(path), plan)
    sound = True
    for path in sorted((folder / "groups").glob("*.json")):
        try:
            manifest = read_as(path, _Manifest, "a manifest", "capture the group again")
        except InputError as error:
            yield Checked(path, Fault(str(error), path))
            sound = False
            continue
        yield Checked(path, None, _states_json(path))
        for frame in (frame for shot in manifest.shots for frame in shot.frames):
            photograph = manifest.kind == "list"  # the rig's frames are checked with the journal
            file = folder / frame.file
            yield _check_frame(file, frame.sha256, path) if photograph else Checked(file)
    if sound and (journal.is_file() or (folder / "frames").is_dir()):  # else the manifests are made again first
        yield from _check_journal(folder, journal)


def _check_journal(folder: Path, journal: Path) -> Iterator[Checked]:
    """Check journal, sidecars and frames of the rig."""
    try:
        _, wrong = bit_rot.verify(folder)
    except InputError as error:
        yield Checked(journal, Fault(str(error)))
        return
    yield Checked(journal)
    for said in wrong:
        again = "restore it from a copy, or have its direction shot again by a row in config/recapture.tsv"
        yield Checked(Path(said.partition(": ")[0]), Fault(said if "; " in said else f"{said}; {again}"))


def check_results(folder: Path) -> Iterator[Checked]:
    """Check all files of a fabric's results, the shards of its stacks among them."""
    stacks = [path for path in (folder / "radiance.zarr", folder / "needed" / "radiance.zarr") if path.is_dir()]
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        inside = path.relative_to(folder).parts
        hidden = any(part.startswith(".") for part in inside)
        if hidden or inside[0] in ("benchmarks", "chart") or any(stack in path.parents for stack in stacks):
            continue
        check = CHECKS.get(path.suffix)
        if check is None:
            yield Checked(path, has_checksum=False)
        else:
            yield _checked(path, check, path.with_name(MADE_WITH.get(path.name, path.name)))
    for stack in stacks:
        yield from _check_stack(stack)
    if stacks:
        for receipt in sorted((folder / "merged").glob("*.json")):
            yield _checked(receipt, lambda path: _receipt(path, folder / "radiance.zarr"), receipt)


def _checked(path: Path, check: Callable[[Path], object], forced: Path | None) -> Checked:
    """Check a file with a function that returns whether it has a checksum."""
    try:
        return Checked(path, has_checksum=bool(check(path)))
    except InputError as error:
        return Checked(path, Fault(str(error), forced))


def _check_frame(path: Path, digest: str, manifest: Path) -> Checked:
    found = sha256(path) if path.is_file() else ""
    if found == digest:
        return Checked(path)
    what = "is missing" if not found else f"is not the frame that {manifest} has the digest of"
    return Checked(path, Fault(f"{path}: {what}; restore it, or take it as it is now", manifest))


def _check_stack(folder: Path) -> Iterator[Checked]:
    """Check metadata and shards of a stack, each chunk by its codec."""
    complete = folder / "zarr.json"
    try:
        stack = Stack.open(folder)
    except InputError as error:
        yield Checked(complete, Fault(str(error), complete))
        return
    for name in (".", *NAMES):
        yield Checked(folder / name / "zarr.json", None, _states_json(folder / name / "zarr.json"))
    for first in range(0, len(stack.lights), SHARD):
        lights = range(first, min(first + SHARD, len(stack.lights)))
        for box in stack.tiles():
            try:
                stack.read_stored(*box, lights)
            except InputError as error:
                damaged = Path(str(error).partition(": ")[0])
                yield Checked(damaged, Fault(str(error), None, damaged))
                break
        else:
            for name in NAMES:
                yield Checked(shard_path(folder, name, first // SHARD))


def _states_json(path: Path) -> bool:
    return JSON_LINE.search(path.read_bytes()) is not None


def _json(path: Path) -> bool:
    read_json(path)
    return _states_json(path)


def _exr(path: Path) -> bool:
    return CRC32 in read_exr_with_header(path)[1]


def _png(path: Path) -> bool:
    check_png(path)
    return True


def _receipt(path: Path, stack: Path) -> bool:
    check_receipt(path, stack)
    return True


def _comment(path: Path) -> bool:
    check_comment(path)
    return MARK in path.read_bytes()


CHECKS: dict[str, Callable[[Path], object]] = {
    ".json": _json,
    ".exr": _exr,
    ".npz": read_npz,
    ".png": _png,
    ".ply": _comment,
    ".xml": _comment,
    ".html": _comment,
}
"""Function that checks a file of each kind: it returns whether the file has a checksum."""
