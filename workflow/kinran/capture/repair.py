"""Repair the journal of a capture: build it again from its sound lines, its copy, the sidecars and the frames.

A bracket is proven if its records are whole and the bytes of all its frames have the digests that they name. Frames
that nothing proves stay where they are and are listed; a capture shoots their brackets again. The damaged journal is
kept.
"""

import difflib
import logging
import os
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path

from kinran.base.files import DISK, InputError, sha256
from kinran.base.log import progress
from kinran.capture.brackets_taken import frame_place, read_brackets
from kinran.capture.journal import COPY, JOURNAL, Record, line, lock, parse, split, sync_folder, write_synced
from kinran.capture.lost_records import aside_name, unknown_files
from kinran.capture.sidecar import Sidecar, keep_sidecar, read_sidecars
from kinran.capture.store import remove_parts
from kinran.data.picture_kind import is_raw
from kinran.data.raw import read_raw

log = logging.getLogger(__name__)

Sidecars = dict[int, Sidecar]
Digests = dict[str, str]
"""SHA-256 of each file, by its path relative to the folder of the capture."""


OF_BRACKET = ("frame", "dose")
"""Records that name the bracket under way; others may name an older one."""
LOST: Record = {
    "t": "intent", "lost": True, "session": -1, "group": "", "shot": "", "revision": 0, "setup": "", "exposures": [],
    "pose": [0, 0, 0, 0], "photodiode": 0, "time": 0.0, "boot": 0, "counter": 0, "card": [], "subject": "fabric",
}  # fmt: skip
"""Intent of which no more is known than that it was there; its exposures, for the dose of light, are the longest of the
capture's brackets."""


@dataclass
class Outcome:
    """What a repair found.

    Attributes
    ----------
    proven, frames
        Brackets whose frames all have the digests of their records, and their number of frames.
    void
        Brackets that had been quarantined, replaced, or never completed.
    lost
        Brackets of which nothing is known but that they had been begun.
    gone
        Frames that are recorded, but are not there.
    unproven
        Files that stand in the place of frames, each with what is known of it.
    kept
        Names under which damaged files are kept.
    written
        Sidecars that were missing or damaged, and are written again.
    changed
        Whether the journal is another than before.
    """

    proven: int = 0
    frames: int = 0
    void: int = 0
    lost: int = 0
    gone: list[str] = field(default_factory=list)
    unproven: dict[str, str] = field(default_factory=dict)
    kept: list[str] = field(default_factory=list)
    written: int = 0
    changed: bool = False


@dataclass
class _Block:
    """An intent, if it is known, and the records after it, up to the next intent."""

    intent: Record | None = None
    after: list[Record] = field(default_factory=list)


def repair(root: Path) -> Outcome:
    """Repair the journal of a capture, and return what could be proven; a sound one is left as it is.

    Parameters
    ----------
    root
        Folder of the capture.

    Raises
    ------
    InputError
        There is no such capture, a capture of it is running, or its disk is full, fails or cannot be written to.
    """
    if not (root / "frames").is_dir() and not (root / JOURNAL).exists():
        raise InputError(f"{root}: has neither frames nor a journal; give the name of a fabric under captures/")
    there = (root / JOURNAL).exists()
    held = lock(root / JOURNAL)
    try:
        remove_parts(root)
        outcome = Outcome()
        digests = hash_files(root)
        sidecars, damaged = read_sidecars(root)
        before = (root / JOURNAL).read_bytes()
        copied = (root / COPY).read_bytes() if (root / COPY).exists() else b""
        sources = [lines for lines in (sound_lines(copied), sound_lines(before)) if _belongs(lines, digests)]
        records, added = _rebuilt(_merged(*sources) if len(sources) == 2 else [*chain(*sources)], sidecars)
        _judge(root, records, added, digests, outcome)
        after = b"".join(line(record) for record in records)
        outcome.changed = not there or after != before
        if outcome.changed:
            if before:
                outcome.kept.append(_keep(root / JOURNAL))
            write_synced(root / JOURNAL, after)
        if after != copied:
            if copied and not after.startswith(copied):
                outcome.kept.append(_keep(root / COPY))
            write_synced(root / COPY, after)
        _heal_sidecars(root, records, sidecars, damaged, outcome)
        return outcome
    except OSError as error:
        if error.errno not in DISK:
            raise
        raise InputError(f"{root}: {DISK[error.errno]} and run the repair again; nothing was deleted") from None
    finally:
        os.close(held)


def hash_files(root: Path) -> Digests:
    """Return the SHA-256 of all files under the folders of frames, of quarantine and of superseded frames."""
    paths = [
        path
        for folder in ("frames", "quarantine", "superseded")
        for path in sorted((root / folder).rglob("*"))
        if path.is_file() and path.suffix not in (".part", ".jsonl")
    ]
    found = {}
    for path in progress(paths, root.name, "files hashed"):
        try:
            found[path.relative_to(root).as_posix()] = sha256(path)
        except OSError as error:
            log.warning("%s: cannot be read (%s)", path, error.strerror)
            found[path.relative_to(root).as_posix()] = ""
    return found


def sound_lines(text: bytes) -> list[Record]:
    """Return the records of the lines that are sound, also of a file whose line ends or encoding a program changed."""
    readings = [text, text.replace(b"\r\n", b"\n"), text.removeprefix(b"\xef\xbb\xbf")]
    for encoding in ("utf-16", "utf-16-le", "utf-16-be"):
        try:
            readings.append(text.decode(encoding).replace("\r\n", "\n").encode())
        except UnicodeError:
            continue
    found = [[record for each in split(reading) if (record := parse(each)) is not None] for reading in readings]
    return max(found, key=len)


def _belongs(records: list[Record], digests: Digests) -> bool:
    """Return whether records tell of the files that are here: those of another fabric name none of their digests."""
    named = {record["sha256"] for record in records if record["t"] == "frame"}
    return not named or not named.isdisjoint(digests.values())


def _merged(copied: list[Record], found: list[Record]) -> list[Record]:
    """Return the records of both, in order; what only one of them has stands between what both have."""
    a, b = [line(record) for record in copied], [line(record) for record in found]
    merged: list[Record] = []
    for _, first, last, start, end in difflib.SequenceMatcher(None, a, b, autojunk=False).get_opcodes():
        both = a[first:last] == b[start:end]
        merged += copied[first:last] + ([] if both else found[start:end])
    return merged


def _rebuilt(records: list[Record], sidecars: Sidecars) -> tuple[list[Record], set[int]]:
    """Return the records with those of the sidecars in their places, and marks for what is lost.

    The second value has the brackets whose frames only a sidecar records.
    """
    added = set()
    head, blocks = _blocks(records, sidecars)
    void = {record.get("intent") for record in records if record["t"] in ("quarantined", "superseded", "unproven")}
    for number, sidecar in sidecars.items():
        block = blocks.setdefault(number, _Block())
        block.intent = sidecar.intent
        if number in void:
            continue
        have = {record["k"]: record["sha256"] for record in block.after if record["t"] == "frame"}
        lacks = any(record not in block.after for record in sidecar.others)
        if not have:
            added.add(number)
        if lacks or have != {frame["k"]: frame["sha256"] for frame in sidecar.frames}:
            mine = (*sidecar.others, *sidecar.frames)
            block.after = [*mine, *(r for r in block.after if r["t"] != "frame" and r not in sidecar.others)]
    sessions = _Sessions({sidecar.session["session"]: sidecar.session for sidecar in sidecars.values()})
    longest: list[float] = max((b.intent["exposures"] for b in blocks.values() if b.intent), key=sum, default=[])
    rebuilt = [each for record in head for each in sessions.before(record)]
    for number in range(max(blocks, default=-1) + 1):
        block = blocks.get(number, _Block())
        if block.intent:
            rebuilt += sessions.before(block.intent)
        else:
            rebuilt.append(LOST | {"exposures": longest})
        rebuilt += [each for record in block.after for each in sessions.before(record)]
    return rebuilt, added


class _Sessions:
    """Puts in the sessions that are lost: their number must be right, for times are compared within one."""

    def __init__(self, known: dict[int, Record]) -> None:
        self._known = known
        self._next = 0

    def before(self, record: Record) -> list[Record]:
        """Return the lost sessions that come before a record, and the record."""
        out: list[Record] = []
        if record["t"] in ("session", "intent"):
            last = record["session"] + (record["t"] == "intent")
            for number in range(self._next, last):
                out.append(self._known.get(number, {"t": "session", "session": number, "lost": True}))
            self._next = max(self._next, record["session"] + 1)
        return [*out, record]


def _blocks(records: list[Record], sidecars: Sidecars) -> tuple[list[Record], dict[int, _Block]]:
    """Sort records by the number of their intent; return those before the first intent, and the others.

    The number of an intent is that of its sidecar, or the one that the records after it name, or the next.
    """
    numbers = {line(sidecar.intent): number for number, sidecar in sidecars.items()}
    head: list[Record] = []
    blocks: dict[int, _Block] = {}
    current = -1
    for place, record in enumerate(records):
        if record["t"] == "intent":
            named = numbers.get(line(record), _named(islice(records, place + 1, None)))
            number = current + 1 if named is None else named
            if number in blocks and blocks[number].intent == record:
                continue  # the same line twice
            if number in blocks and blocks[number].intent is not None:
                number = max(blocks) + 1
            current = number
            block = blocks.setdefault(current, _Block())
            block.intent = record
            continue
        if record["t"] in OF_BRACKET:
            current = max(current, record["intent"])
        of_block = blocks.setdefault(current, _Block()).after if current >= 0 else head
        of_block.append(record)
    return head, blocks


def _named(later: Iterable[Record]) -> int | None:
    """Return the number that an intent has in the records after it; None if none names it before the next intent."""
    for record in later:
        if record["t"] == "intent":
            return None
        if record["t"] in OF_BRACKET:
            return int(record["intent"])
    return None


def _judge(root: Path, records: list[Record], added: set[int], digests: Digests, outcome: Outcome) -> None:
    """Compare each bracket with its frames; append records that void what is not proven, and name what is unknown.

    A bracket of `added` is void if a frame of it is in quarantine: its sidecar is older than that.
    """
    brackets = read_brackets(records)
    aside = {digest for file, digest in digests.items() if file.startswith("quarantine/")}
    owned: set[str] = set()
    for number in reversed(range(len(brackets))):  # of brackets with the same names the newest has the files
        bracket = brackets[number]
        outcome.lost += "lost" in bracket.intent
        if not bracket.complete:
            outcome.void += "lost" not in bracket.intent
            continue
        frames = [bracket.frames[k] for k in sorted(bracket.frames)]
        wrong = [frame for frame in frames if digests.get(frame["file"]) != frame["sha256"]]
        moved = {digests.get(f"superseded/{number}/{Path(frame['file']).name}") for frame in frames}
        if number in added and {frame["sha256"] for frame in frames} & aside:
            records.append({"t": "quarantined", "intent": number, "reason": "found in quarantine", "files": []})
            outcome.void += 1
        elif moved & {frame["sha256"] for frame in frames} or owned.intersection(f["file"] for f in frames):
            records.append({"t": "superseded", "intent": number, "files": [frame["file"] for frame in frames]})
            outcome.void += 1
        elif not wrong:
            owned.update(frame["file"] for frame in frames)
            outcome.proven += 1
            outcome.frames += len(frames)
        else:
            outcome.gone += [frame["file"] for frame in wrong if frame["file"] not in digests]
            if any(frame["file"] in digests for frame in wrong):
                records.append({"t": "unproven", "intent": number, "files": []})
    _name_unknown(root, records, digests, owned, outcome)


def _name_unknown(root: Path, records: list[Record], digests: Digests, owned: set[str], outcome: Outcome) -> None:
    """List the files that stand as frames of no proven bracket, and append records for those of no bracket at all."""
    for file in digests:
        if frame_place(file) and file.startswith("frames/") and file not in owned:
            outcome.unproven[file] = _said(root / file)
    brackets = read_brackets(records)
    unknown = [path.relative_to(root).as_posix() for path in unknown_files(root, records, brackets)]
    aside = [file for file in unknown if file.startswith("quarantine/")]
    if aside:
        files = [{"name": aside_name(Path(file)), "file": file, "sha256": digests[file]} for file in aside]
        records.append({"t": "quarantined", "intent": None, "reason": "found in quarantine", "files": files})
    frames = [file for file in unknown if file.startswith("frames/")]
    if frames:
        files = [{"file": file, "sha256": digests[file]} for file in frames]
        records.append({"t": "unproven", "intent": None, "files": files})
    for file in unknown:
        if file.startswith("superseded/") and (folder := Path(file).parent.name).isdigit():
            lost = int(folder) + 1 - len(read_brackets(records))
            records += [LOST] * max(lost, 0)


def _said(path: Path) -> str:
    """Return what a frame says of itself, which is no proof of pose or light."""
    if not is_raw(path):
        return "nothing says what it is"
    try:
        seconds = read_raw(path).seconds
    except InputError:
        return "it does not decode"
    return f"EXIF says {seconds:g} s; nothing says under which light"


def _keep(path: Path) -> str:
    """Give a damaged file another name, which it returns; the file itself is there until the new one replaces it."""
    number = 1
    while (kept := path.with_name(f"{path.stem}.damaged-{number}{path.suffix}")).exists():
        number += 1
    write_synced(kept, path.read_bytes())
    sync_folder(path.parent)
    return kept.name


def _heal_sidecars(
    root: Path, records: list[Record], sidecars: Sidecars, damaged: list[Path], outcome: Outcome
) -> None:
    """Write the sidecars that complete brackets lack; give those that no complete bracket has another name."""
    for path in damaged:
        outcome.kept.append(path.replace(path.with_suffix(".damaged")).name)
    for number, bracket in enumerate(read_brackets(records)):
        if bracket.complete and number not in sidecars:
            frames = [bracket.frames[k] for k in sorted(bracket.frames)]
            keep_sidecar(root, number, records, bracket.intent, frames)
            outcome.written += 1


def report(fabric: str, found: Outcome) -> str:
    """Return what a repair found in a few lines."""
    lines = [f"{fabric}: {found.proven} brackets with {found.frames} frames are proven by their digests"]
    if found.void:
        lines.append(f"  {found.void} brackets had been replaced, put in quarantine, or not been completed")
    if found.lost:
        lines.append(f"  {found.lost} brackets had been begun, and nothing else is known of them")
    lines += [f"  {file}: is recorded, but not there" for file in sorted(found.gone)]
    lines += [f"  {file}: is not proven: {said}" for file, said in sorted(found.unproven.items())]
    if found.written:
        lines.append(f"  {found.written} sidecars are written again")
    if found.kept:
        lines.append(f"  what was damaged is kept as {' and '.join(found.kept)}")
    lines.append(f"  {JOURNAL} {'is written anew' if found.changed else 'was in order, and is as it was'}")
    if found.unproven or found.gone:
        lines.append(
            "  what is not proven is shot again by the next capture, and stays until then: captures replace no file"
        )
    return "\n".join(lines)
