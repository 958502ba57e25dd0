"""The files of a capture: frames get their final names only when the disk has them whole."""

import hashlib
import os
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError, sha256
from kinran.capture.brackets_taken import JournalBracket
from kinran.capture.journal import Record, sync_folder
from kinran.rig.camera import Camera, CameraError, CardFile, FrameFacts

UNRECORDED = "unrecorded"
"""Folder in ``superseded`` of files that made room for a frame; the name of each begins with its digest."""
FETCHES = 3
"""Times that a file is fetched from the card before the session stops: a choice."""


@dataclass(frozen=True)
class Landed:
    """A frame on disk: its path relative to the capture's folder, digest and size."""

    file: str
    sha256: str
    bytes: int


@dataclass(frozen=True)
class Fetched:
    """A copy of a file on the card that two readings agree on; it has no final name yet.

    Attributes
    ----------
    source
        The file on the card.
    part
        The copy, synced.
    sha256
        Its digest.
    facts
        What the frame says of itself; None where it does not decode.
    problem
        Why it does not decode; empty where it does.
    """

    source: CardFile
    part: Path
    sha256: str
    facts: FrameFacts | None
    problem: str = ""


def check_space(root: Path, frames: int, records: Iterable[Record]) -> None:
    """Check that the disk has room for so many frames, as large as the largest in the journal.

    Raises
    ------
    InputError
        The disk has too little space.
    """
    largest = max((record["bytes"] for record in records if record["t"] == "frame"), default=0)
    need = frames * largest * 1.1
    free = shutil.disk_usage(root).free
    if need > free:
        raise InputError(
            f"{root}: {frames} frames need {need / 1e6:.0f} MB and {free / 1e6:.0f} MB are free;"
            " free some space and run the capture again"
        )


def fetch(camera: Camera, root: Path, source: CardFile) -> Fetched:
    """Copy a file from the card, until its size is what the camera says and a second reading agrees with the first.

    A copy that does not decode is fetched again, too; one that never does is returned with its problem.

    Raises
    ------
    CameraError
        No two readings agree, in `FETCHES` tries, or the file is empty; it is still on the card.
    OSError
        The disk is full or fails; no copy is left in that case.
    """
    part = root / f"card-{hashlib.sha256(source.name.encode()).hexdigest()[:12]}.part"
    problem = "it is empty"
    sound: Fetched | None = None
    try:
        for _ in range(FETCHES if source.bytes else 0):
            sound = None
            try:
                camera.download(source.name, part)
                with part.open("rb+") as stream:
                    data = stream.read()
                    os.fsync(stream.fileno())
                digest = hashlib.sha256(data).hexdigest()
                if len(data) != source.bytes:
                    problem = f"{len(data)} of {source.bytes} bytes came"
                    continue
                if camera.digest(source.name) != digest:
                    problem = "two readings of it differ"
                    continue
            except CameraError as error:
                problem = str(error)
                continue
            try:
                return Fetched(source, part, digest, camera.facts(part))
            except CameraError as error:
                sound = Fetched(source, part, digest, None, str(error))
    except OSError:
        part.unlink(missing_ok=True)
        raise
    if sound is not None:
        return sound
    part.unlink(missing_ok=True)
    raise CameraError(
        f"{source.name} cannot be fetched whole: {problem}; it is still on the card:"
        " check cable and card, then run the capture again"
    )


def land(root: Path, frames: Sequence[Fetched], targets: Sequence[Path]) -> list[Landed]:
    """Give copies their final names, and sync their folder. All targets lie in one folder.

    Whatever stands under a final name already, and is not the same frame, is moved to the folder ``superseded``: a
    frame is never overwritten.

    Raises
    ------
    OSError
        The disk fails.
    """
    folder = targets[0].parent
    folder.mkdir(parents=True, exist_ok=True)
    for frame, target in zip(frames, targets, strict=True):
        if target.exists() and (digest := sha256(target)) != frame.sha256:
            aside = root / "superseded" / UNRECORDED
            aside.mkdir(parents=True, exist_ok=True)
            target.replace(aside / f"{digest[:12]}_{target.name}")
            sync_folder(aside)
        frame.part.replace(target)
    sync_folder(folder)
    return [
        Landed(target.relative_to(root).as_posix(), frame.sha256, frame.source.bytes)
        for frame, target in zip(frames, targets, strict=True)
    ]


def quarantine(root: Path, frames: Sequence[Fetched]) -> list[Landed]:
    """Give copies of surplus frames, and of those of a void bracket, names in the folder ``quarantine``."""
    names = [f"{frame.sha256[:12]}_{Path(frame.source.name).name}" for frame in frames]
    return land(root, frames, [root / "quarantine" / name for name in names])


def set_aside(root: Path, files: Sequence[str], folder: Path) -> None:
    """Move frames that newer ones will replace to `folder`; missing ones are ignored."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        source = root / file
        if source.exists():
            source.replace(folder / source.name)
            sync_folder(source.parent)
    sync_folder(folder)


def tidy_card(camera: Camera, records: Iterable[Record], brackets: Iterable[JournalBracket]) -> None:
    """Delete frames on the card that are recorded: a session was killed before it deleted them."""
    recorded: dict[str, set[str]] = {}
    whole = [bracket for bracket in brackets if bracket.recorded]  # its records may be torn, too
    entries = [frame for bracket in whole for frame in bracket.frames.values()]
    for record in records:
        if record["t"] == "quarantined":
            entries += record["files"]
    for entry in entries:
        recorded.setdefault(entry["name"], set()).add(entry["sha256"])
    for file in camera.card():
        if file.name in recorded and camera.digest(file.name) in recorded[file.name]:
            camera.delete(file.name)


def remove_parts(root: Path) -> None:
    """Delete the temporary files of an interrupted download."""
    for folder in (root, root / "quarantine", *(root / "frames").glob("*")):
        for part in folder.glob("*.part"):
            part.unlink()
