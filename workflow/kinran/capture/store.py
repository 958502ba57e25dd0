"""The files of a capture: frames get their final names only when the disk has them whole."""

import hashlib
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.rig.camera import Camera, CameraError


@dataclass(frozen=True)
class Landed:
    """A frame on disk: its path relative to the capture's folder, digest and size."""

    file: str
    sha256: str
    bytes: int


def land(camera: Camera, root: Path, names: Sequence[str], targets: Sequence[Path]) -> list[Landed]:
    """Copy frames from the card to temporary names, sync them, rename them all, and sync their folder.

    The frames stay on the card. All targets lie in one folder.

    Raises
    ------
    CameraError
        A frame is empty.
    OSError
        The disk is full or fails; no target exists in that case.
    """
    folder = targets[0].parent
    folder.mkdir(parents=True, exist_ok=True)
    parts = [target.with_name(target.name + ".part") for target in targets]
    try:
        landed = [
            _copy(camera, name, part, target.relative_to(root))
            for name, part, target in zip(names, parts, targets, strict=True)
        ]
    except OSError:
        for part in parts:
            part.unlink(missing_ok=True)
        raise
    for part, target in zip(parts, targets, strict=True):
        part.replace(target)
    sync_folder(folder)
    return landed


def _copy(camera: Camera, name: str, part: Path, file: Path) -> Landed:
    camera.download(name, part)
    with part.open("rb+") as stream:
        data = stream.read()
        os.fsync(stream.fileno())
    if not data:
        raise CameraError(f"{name}: came empty from the card; look at the card, then run the capture again")
    return Landed(file.as_posix(), hashlib.sha256(data).hexdigest(), len(data))


def digest_on_card(camera: Camera, root: Path, name: str) -> str:
    """Return the SHA-256 of a file on the card, in hexadecimal."""
    part = root / "card-file.part"
    camera.download(name, part)
    digest = hashlib.sha256(part.read_bytes()).hexdigest()
    part.unlink()
    return digest


def quarantine(camera: Camera, root: Path, names: Sequence[str]) -> list[Landed]:
    """Copy surplus files, and those of a void bracket, to the folder ``quarantine``; they stay on the card."""
    folder = root / "quarantine"
    targets = [folder / f"{digest_on_card(camera, root, name)[:12]}_{name}" for name in names]
    return land(camera, root, names, targets)


def set_aside(root: Path, files: Sequence[str], folder: Path) -> None:
    """Move frames that newer ones will replace to `folder`; missing ones are ignored."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        source = root / file
        if source.exists():
            source.replace(folder / source.name)
            sync_folder(source.parent)
    sync_folder(folder)


def remove_parts(root: Path) -> None:
    """Delete the temporary files of an interrupted download."""
    for folder in (root, root / "quarantine", *(root / "frames").glob("*")):
        for part in folder.glob("*.part"):
            part.unlink()


def sync_folder(folder: Path) -> None:
    """Wait until the disk has the names in a folder."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
