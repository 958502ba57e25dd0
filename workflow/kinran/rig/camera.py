"""The interface of a camera, real or simulated, for capture."""

from pathlib import Path
from typing import Protocol


class Camera(Protocol):
    """A camera whose frames land on its card first, and outlive the host there."""

    suffix: str
    """Suffix of its files, such as ``.dng``."""

    def place(self, subject: str) -> None:
        """Ask for a subject before the lens: ``fabric``, ``white`` (plate), ``chart`` or ``dark`` (cap)."""

    def expose(self, seconds: float) -> None:
        """Take one frame at this nominal shutter time; the file lands on the card.

        Raises
        ------
        CameraError
            No frame was taken.
        """

    def card(self) -> list[str]:
        """Names of the files on the card, oldest first."""

    def download(self, name: str, to: Path) -> None:
        """Copy a file from the card."""

    def delete(self, name: str) -> None:
        """Delete a file on the card."""


class CameraError(Exception):
    """Failure of the camera; the message says what happened and the remedy."""
