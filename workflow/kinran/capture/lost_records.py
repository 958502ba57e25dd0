"""What the files beside a journal tell of records that it has lost: a copy, sidecars, and frames that it does not know.

The CRC of each line tells a damaged line; it does not tell lines that are gone, or the journal of another fabric.
"""

import logging
import re
from collections.abc import Iterator
from pathlib import Path

from kinran.base.files import InputError, sha256
from kinran.capture.brackets_taken import JournalBracket, frame_place, place, read_brackets
from kinran.capture.journal import COPY, JOURNAL, Journal, Record, parse, remedy, split
from kinran.capture.sidecar import Sidecar, read_sidecars

log = logging.getLogger(__name__)

_ASIDE = re.compile(r"[0-9a-f]{12}_(.+)")
"""Name of a file in quarantine, or of one that made room for a frame."""


def aside_name(path: Path) -> str:
    """Return the name that a file that was put aside had before; empty if no capture put it there."""
    found = _ASIDE.fullmatch(path.name)
    return found[1] if found else ""


def checked_brackets(root: Path, records: list[Record]) -> list[JournalBracket]:
    """Return the brackets of a journal that has lost none of its records, as far as the files beside it can tell.

    Parameters
    ----------
    root
        Folder of the capture.
    records
        Records of its journal.

    Raises
    ------
    InputError
        A copy or a sidecar has a record that the journal lacks, or there are frames that it does not know.
    """
    journal, cure = root / JOURNAL, remedy(root)
    count = 0
    for number, record in enumerate(records, 1):
        count += record["t"] == "intent"
        if record.get("intent") is not None and record["intent"] >= count:
            raise InputError(f"{journal}: line {number} names a bracket that stands in no line before it; {cure}")
    for number, copied in enumerate(copied_records(root)):
        if copied is not None and (number >= len(records) or records[number] != copied):
            raise InputError(f"{journal}: lacks line {number + 1} of its copy {COPY}; {cure}")
    brackets = read_brackets(records)
    sidecars, damaged = read_sidecars(root)
    for path in damaged:
        log.warning("capture: %s is damaged; `kinran rig repair %s` writes it again", path, root.resolve().name)
    for number, sidecar in sidecars.items():
        if not _agrees(brackets, number, sidecar):
            shot = sidecar.intent["shot"]
            raise InputError(f"{journal}: does not have bracket {number}, {shot}, as its sidecar has it; {cure}")
    for path in unknown_files(root, records, brackets):
        raise InputError(f"{path}: is there, but {JOURNAL} does not know it; {cure}")
    return brackets


def copied_records(root: Path) -> list[Record | None]:
    """Return the records of the journal's copy; None for a damaged line, and nothing where there is no copy."""
    path = root / COPY
    return [parse(each) for each in split(path.read_bytes())] if path.exists() else []


def _agrees(brackets: list[JournalBracket], number: int, sidecar: Sidecar) -> bool:
    """Return whether the journal has a bracket as its sidecar says; a killed session leaves the last one unrecorded."""
    if number >= len(brackets):
        return False
    bracket = brackets[number]
    if bracket.intent != sidecar.intent:
        return False
    if bracket.void:
        return True
    if not bracket.recorded:
        return number == len(brackets) - 1
    return all(bracket.frames[frame["k"]]["sha256"] == frame["sha256"] for frame in sidecar.frames)


def unknown_files(root: Path, records: list[Record], brackets: list[JournalBracket]) -> Iterator[Path]:
    """Yield the files in the folders of frames, of quarantine and of superseded frames that a journal does not know.

    Known are those that a record names, and those whose names a bracket of the journal gives its frames: a session may
    have been killed before it recorded them. Files with names that no capture gives are none of its business.
    """
    places = {place(bracket.intent) for bracket in brackets}
    named = {file["file"] for record in records for file in record.get("files", ()) if isinstance(file, dict)}
    for path in sorted((root / "frames").glob("*/*")):
        file = path.relative_to(root).as_posix()
        if (at := frame_place(file)) and at not in places and file not in named:
            yield path
    if not brackets or brackets[-1].complete:  # else a session may have been killed before it recorded them
        taken = {frame["sha256"][:12] for bracket in brackets for frame in bracket.frames.values()}
        for path in sorted((root / "quarantine").glob("*")):
            copy = path.name[:12] in taken  # a session was killed in putting aside what the next one adopted
            if aside_name(path) and not copy and path.relative_to(root).as_posix() not in named:
                yield path
    for path in sorted((root / "superseded").glob("*/*")):
        if frame_place(path.name) and path.parent.name.isdigit() and int(path.parent.name) >= len(brackets):
            yield path


def record_last(root: Path, journal: Journal, brackets: list[JournalBracket]) -> None:
    """Record the last bracket if a session was killed between its sidecar and its records, and all frames are whole.

    It is not left to the card alone, which may have been taken out.
    """
    if not brackets or brackets[-1].recorded or brackets[-1].void:
        return
    sidecars, _ = read_sidecars(root)
    sidecar = sidecars.get(len(brackets) - 1)
    if sidecar and all(_stands(root, frame) for frame in sidecar.frames):
        journal.append(*sidecar.frames)
        brackets[-1].frames = {frame["k"]: frame for frame in sidecar.frames}


def _stands(root: Path, frame: Record) -> bool:
    path = root / frame["file"]
    aside = (root / "quarantine").glob(f"{frame['sha256'][:12]}_*")
    return path.is_file() and sha256(path) == frame["sha256"] and not any(aside)
