"""Sidecars of brackets: beside its frames stand the journal's own lines of a bracket, from which it can be rebuilt."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from kinran.base.files import InputError
from kinran.capture.journal import Record, line, read, write_synced

_NAME = re.compile(r".+_r\d+\.(\d+)\.jsonl")


def sidecar_path(root: Path, number: int, intent: Record) -> Path:
    """Return the path of the sidecar of a bracket: shot, revision, and the number of its intent in the journal."""
    return root / "frames" / intent["group"] / f"{intent['shot']}_r{intent['revision']}.{number:05d}.jsonl"


def keep_sidecar(root: Path, number: int, records: Iterable[Record], intent: Record, frames: Sequence[Record]) -> None:
    """Write the sidecar of a bracket: its session, its intent, and its frames, which need not be in the journal yet.

    Parameters
    ----------
    root
        Folder of the capture.
    number
        Number of the intent among those of the journal.
    records
        Records of the journal, among them the session of the intent.
    intent, frames
        Records of the bracket.
    """
    of_intent = (r for r in records if r["t"] == "session" and r["session"] == intent["session"])
    lines = [line(record) for record in (next(of_intent), intent, *frames)]
    write_synced(sidecar_path(root, number, intent), b"".join(lines))


def read_sidecars(root: Path) -> tuple[dict[int, list[Record]], list[Path]]:
    """Read all sidecars of a capture.

    Returns
    -------
    dict
        Records (session, intent, frames) by the number of the intent.
    list
        Sidecars that are damaged or cut.
    """
    sound: dict[int, list[Record]] = {}
    damaged = []
    for path in sorted((root / "frames").glob("*/*.jsonl")):
        if not (name := _NAME.fullmatch(path.name)):
            continue
        number = int(name[1])
        try:
            records, size = read(path)
        except InputError:
            records, size = [], 0
        whole = (
            [record["t"] for record in records] == ["session", "intent", *["frame"] * (len(records) - 2)]
            and len(records) - 2 == len(records[1]["exposures"])
            and all(record["intent"] == number for record in records[2:])
            and size == path.stat().st_size
        )
        if whole and number not in sound:
            sound[number] = records
        else:
            damaged.append(path)
    return sound, damaged
