"""Sidecars of brackets: beside its frames stand the journal's own lines of a bracket, from which it can be rebuilt."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError
from kinran.capture.journal import Record, line, read, write_synced

_NAME = re.compile(r".+_r\d+\.(\d+)\.jsonl")


@dataclass(frozen=True)
class Sidecar:
    """The records of a complete bracket.

    Attributes
    ----------
    session, intent
        Records of its session and its intent.
    others
        Records that name the bracket besides its frames, such as that of its light.
    frames
        Records of its frames.
    """

    session: Record
    intent: Record
    others: tuple[Record, ...]
    frames: tuple[Record, ...]


def sidecar_path(root: Path, number: int, intent: Record) -> Path:
    """Return the path of the sidecar of a bracket: shot, revision, and the number of its intent in the journal."""
    return root / "frames" / str(intent["group"]) / f"{intent['shot']}_r{intent['revision']}.{number:05d}.jsonl"


def keep_sidecar(root: Path, number: int, records: Iterable[Record], intent: Record, frames: Sequence[Record]) -> None:
    """Write the sidecar of a bracket, before its frames are in the journal.

    Parameters
    ----------
    root
        Folder of the capture.
    number
        Number of the intent among those of the journal.
    records
        Records of the journal.
    intent, frames
        Records of the bracket.
    """
    records = list(records)
    session = [r for r in records if r["t"] == "session" and r["session"] == intent["session"]][:1]
    others = [r for r in records if r.get("intent") == number and r["t"] != "frame"]
    lines = [line(record) for record in (*session, intent, *others, *frames)]
    write_synced(sidecar_path(root, number, intent), b"".join(lines))


def read_sidecars(root: Path) -> tuple[dict[int, Sidecar], list[Path]]:
    """Read all sidecars of a capture.

    Returns
    -------
    dict
        Sidecars by the number of the intent.
    list
        Those that are damaged or cut.
    """
    sound: dict[int, Sidecar] = {}
    damaged = []
    for path in sorted((root / "frames").glob("*/*.jsonl")):
        if not (name := _NAME.fullmatch(path.name)):
            continue
        sidecar = _read(path, int(name[1]))
        if sidecar and int(name[1]) not in sound:
            sound[int(name[1])] = sidecar
        else:
            damaged.append(path)
    return sound, damaged


def _read(path: Path, number: int) -> Sidecar | None:
    """Return a sidecar; None where it is not whole."""
    try:
        records, size = read(path)
    except InputError:
        return None
    if [record["t"] for record in records[:2]] != ["session", "intent"] or size != path.stat().st_size:
        return None
    frames = tuple(record for record in records[2:] if record["t"] == "frame")
    others = tuple(record for record in records[2:] if record["t"] != "frame")
    if len(frames) != len(records[1]["exposures"]) or any(record["intent"] != number for record in records[2:]):
        return None
    return Sidecar(records[0], records[1], others, frames)
