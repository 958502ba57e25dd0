"""The interface of a camera, real or simulated, for capture."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class CardFile:
    """A frame on the card: its name there, and its size in bytes."""

    name: str
    bytes: int


@dataclass(frozen=True)
class FrameFacts:
    """What a frame says of itself.

    Attributes
    ----------
    exposure_s
        Nominal exposure time in seconds; 0 if the frame does not say.
    iso, aperture
        ISO and aperture (f-number); 0 if the frame does not say.
    taken
        When the camera took it, in seconds of the camera's own clock; 0 if the frame does not say.
    """

    exposure_s: float
    iso: float = 0.0
    aperture: float = 0.0
    taken: float = 0.0


@dataclass(frozen=True)
class Health:
    """How a camera fares.

    Attributes
    ----------
    battery
        Charge in the camera's own words, such as ``75%``; empty where it does not say.
    free_bytes
        Free space on the card in bytes; None where it does not say.
    """

    battery: str = ""
    free_bytes: int | None = None

    @property
    def low(self) -> bool:
        """Whether the battery is nearly empty: a quarter or less, or what the camera calls low."""
        percent = self.battery.removesuffix("%")
        return int(percent) <= 25 if percent.isdecimal() else "low" in self.battery.lower()


class Camera(Protocol):
    """A camera whose frames land on its card first, and outlive the host there.

    Every method raises `CameraError` when the camera failed.
    """

    suffix: str
    """Suffix of its files, such as ``.dng``."""

    @property
    def iso(self) -> float:
        """ISO that its frames must say; 0 for any."""

    @property
    def aperture(self) -> float:
        """Aperture (f-number) that its frames must say; 0 for any."""

    def place(self, subject: str) -> None:
        """Ask for a subject before the lens: ``fabric``, ``white`` (plate), ``chart`` or ``dark`` (cap)."""

    def expose(self, seconds: float) -> None:
        """Take one frame at this nominal shutter time; the file lands on the card, if late, after the call.

        Raises
        ------
        CameraError
            No frame was taken, or none landed in time.
        """

    def card(self) -> list[CardFile]:
        """Return the frames on the card, oldest first by the camera's own order, whatever their names."""

    def download(self, name: str, to: Path) -> None:
        """Copy a file from the card."""

    def digest(self, name: str) -> str:
        """Read a file on the card once more, from the card itself, and return its SHA-256 in hexadecimal."""

    def facts(self, path: Path) -> FrameFacts:
        """Decode a copy of a frame.

        Raises
        ------
        CameraError
            It is cut off or damaged.
        """

    def delete(self, name: str) -> None:
        """Delete a frame on the card, and what the camera wrote with it."""

    def health(self) -> Health:
        """Return battery and free space."""


class CameraError(Exception):
    """Failure of the camera; the message says what happened and the remedy."""
