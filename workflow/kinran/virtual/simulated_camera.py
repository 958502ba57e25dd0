"""A simulated camera before a virtual fabric; it writes DNG files to a folder that is its card."""

import shutil
import zlib
from dataclasses import fields
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, sha256
from kinran.base.frames import direction
from kinran.rig.camera import CameraError, CardFile, FrameFacts, Health
from kinran.rig.raw_facts import raw_facts
from kinran.virtual import targets
from kinran.virtual.dng import APERTURE, ISO, Tags, write_dng
from kinran.virtual.sensor import BORDER, Sensor, shutter
from kinran.virtual.weave import COLOURS, VirtualFabric
from kinran.virtual.yarn import MOTIFS

CACHE = Path(".cache/kinran/virtual")
"""Folder in which traced frames are kept."""
LEAST_TEXELS = 16
"""Fewest texels along a side: LibRaw refuses smaller frames."""
TAKEN = "taken.txt"
"""File on the card that lists all frames ever taken."""
SUBJECTS = ("fabric", "white", "chart", "dark")


class Rig(Protocol):
    """The true state of a simulated goniometer, which the camera sees."""

    @property
    def pose(self) -> tuple[float, ...]:
        """Pose in millidegrees; light θ and light φ come first."""

    @property
    def shutter_open(self) -> bool:
        """Whether the lamp's shutter lets light through."""

    @property
    def lamp_seconds(self) -> float:
        """Seconds since the lamp was lit."""

    @property
    def lamp_output(self) -> float:
        """Relative light of the lamp; 0 is off."""


class SimulatedCamera:
    """A camera whose frames depend on scene, rig, exposure and number of the repeat alone.

    Neither the order of the groups nor other shots change a frame.

    Parameters
    ----------
    firmware
        The simulated goniometer.
    card
        Folder that serves as the card and outlives the process.
    scene
        Parameters of the `VirtualFabric` by name; the others have their defaults.
    cache
        Folder in which traced frames are kept.
    group
        Group of the plan that is shot: repeats of a direction in two groups have different noise.

    Attributes
    ----------
    repeat
        Number of the repeat that is shot, which has noise of its own; None: as many as were taken before it.

    Raises
    ------
    InputError
        A parameter is unknown, or its value is out of range.
    """

    suffix = ".dng"
    iso = float(ISO)
    aperture = float(APERTURE)

    def __init__(self, firmware: Rig, card: Path, scene: dict[str, Any], cache: Path = CACHE, group: str = "") -> None:
        self._rig, self._card, self._cache, self._group = firmware, card, cache, group
        self._fabric = _fabric(scene)
        self._sensor = Sensor()
        self._subject = "fabric"
        self.repeat: int | None = None
        card.mkdir(parents=True, exist_ok=True)

    def place(self, subject: str) -> None:
        """Put ``fabric``, ``white`` (plate), ``chart`` or ``dark`` (a cap) before the lens."""
        if subject not in SUBJECTS:
            raise CameraError(f"subject '{subject}': this camera knows {', '.join(SUBJECTS)}")
        self._subject = subject

    def expose(self, seconds: float) -> None:
        """Take one frame at a nominal shutter time in seconds."""
        if not 1 / 8000 < seconds <= 30:
            raise CameraError(f"shutter time {seconds:g} s: this camera has 1/4000 s to 30 s")
        rig, taken = self._rig, self._taken()
        theta, phi = self._pose()
        lamp = rig.lamp_output if rig.shutter_open and self._subject != "dark" else 0.0
        frame = f"{self._group} {self._subject} {theta} {phi} {round(seconds * 1e6)}"
        repeat = taken.count(frame) if self.repeat is None else self.repeat
        bayer = self._sensor.expose(
            self._radiance(theta, phi)[::-1],
            shutter(seconds),
            lamp,
            self._fabric.seed,
            np.array([self._fabric.seed, zlib.crc32(frame.encode()), repeat], np.uint64),
        )
        number = max([len(taken), *(_number(path) for path in self._card.glob(f"IMG_*{self.suffix}"))]) + 1
        path = self._card / f"IMG_{number:05d}{self.suffix}"
        clock = round(rig.lamp_seconds * 1000)
        temporary = path.with_suffix(".part")
        day, hour = divmod(clock // 3_600_000, 24)
        when = f"2000:01:{1 + day:02d} {hour:02d}:{clock // 60_000 % 60:02d}:{clock // 1000 % 60:02d}"
        nominal = Fraction(seconds).limit_denominator(100_000)
        write_dng(temporary, bayer, Tags(nominal, BORDER, self._sensor.black, 4095, when))
        temporary.replace(path)
        with (self._card / TAKEN).open("a") as file:
            file.write(f"{frame}\n")

    def card(self) -> list[CardFile]:
        """Return the frames on the card, oldest first: by the number that the camera counts."""
        files = sorted(self._card.glob(f"IMG_*{self.suffix}"), key=_number)
        return [CardFile(path.name, path.stat().st_size) for path in files]

    def download(self, name: str, to: Path) -> None:
        """Copy a file from the card."""
        shutil.copyfile(self._file(name), to)

    def digest(self, name: str) -> str:
        """Read a file on the card once more, and return its SHA-256."""
        return sha256(self._file(name))

    def facts(self, path: Path) -> FrameFacts:
        """Decode a copy of a frame."""
        return raw_facts(path)

    def health(self) -> Health:
        """Return the free space of the disk that holds the card."""
        return Health(free_bytes=shutil.disk_usage(self._card).free)

    def delete(self, name: str) -> None:
        """Delete a file on the card."""
        self._file(name).unlink()

    def _file(self, name: str) -> Path:
        if name not in [file.name for file in self.card()]:
            raise CameraError(f"{name}: no such file on the card; list the card again")
        return self._card / name

    def _taken(self) -> list[str]:
        """Return a line for each frame ever taken: the camera counts on when files are deleted."""
        path = self._card / TAKEN
        return path.read_text().splitlines() if path.exists() else []

    def _pose(self) -> tuple[int, int]:
        """Return light θ and φ in millidegrees, rounded to the hundredth of a degree in which scenes are traced."""
        theta, phi = (round(angle / 10) * 10 for angle in self._rig.pose[:2])
        if theta < 0:
            theta, phi = -theta, phi + 180_000
        return theta, phi % 360_000 if theta else 0

    def _radiance(self, theta: int, phi: int) -> NDArray[np.float32]:
        fabric = self._fabric
        if self._subject == "dark":
            return np.zeros((fabric.texels, fabric.texels, 3), np.float32)
        if self._subject == "fabric":
            return _traced(fabric, theta, phi, self._cache)
        light = direction(*np.radians(np.array([theta, phi]) / 1000))
        subject = targets.white if self._subject == "white" else targets.chart
        return subject(light, fabric.field_mm, fabric.texels, fabric.lamp_mm)


def _number(path: Path) -> int:
    """Return the number that the camera gave a frame."""
    return int(path.stem.removeprefix("IMG_"))


@lru_cache(maxsize=2)  # a bracket sees the same scene at all its exposures
def _traced(fabric: VirtualFabric, theta: int, phi: int, cache: Path) -> NDArray[np.float32]:
    return fabric.frame(theta, phi, cache)


def _fabric(scene: dict[str, Any]) -> VirtualFabric:
    known = {field.name: field.type for field in fields(VirtualFabric)}
    if unknown := sorted(set(scene) - set(known)):
        raise InputError(f"virtual scene: '{unknown[0]}' is not known; it takes {', '.join(known)}")
    for name, known_words in (("motif", MOTIFS), ("threads", tuple(COLOURS))):
        if scene.get(name, known_words[0]) not in known_words:
            raise InputError(f"virtual scene: {name} = {scene[name]!r}; give one of {', '.join(known_words)}")
    for name, value in scene.items():
        if name in ("motif", "threads"):
            continue
        if isinstance(value, bool) or not isinstance(value, int | float) or value < (name != "seed"):
            raise InputError(f"virtual scene: {name} = {value!r}; give a positive number")
    fabric = VirtualFabric(**scene)
    if fabric.texels < LEAST_TEXELS:
        raise InputError(f"virtual scene: texels = {fabric.texels}; give at least {LEAST_TEXELS}")
    return fabric
