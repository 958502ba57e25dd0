"""The lights that a file states, with what was taken in a way that it does not state."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath

from kinran.base.distances import Vector
from kinran.base.files import InputError
from kinran.data.light import LpLight

AS_THEY_ARE: Vector = (1.0, 1.0, 1.0)
"""Signs of x, y, z that leave them as a file has them."""


@dataclass(frozen=True)
class LightFile:
    """The lights that a file states.

    Attributes
    ----------
    path
        The file.
    lights
        Its lights over the horizon, in its order.
    remarks
        Sentences on what was taken in a way that the file does not state.
    """

    path: Path
    lights: list[LpLight]
    remarks: list[str] = field(default_factory=list)


def over_horizon(path: Path, named: list[tuple[PurePosixPath, Vector]], remarks: list[str], signs: Vector) -> LightFile:
    """Return lights over the horizon, with these signs of their axes; those under it are left out or, if all, turned.

    Raises
    ------
    InputError
        There are none.
    """
    named = [(given, (signs[0] * x, signs[1] * y, signs[2] * z)) for given, (x, y, z) in named]
    turn = 1.0
    if named and all(z < 0 for _, (_, _, z) in named):
        turn = -1.0
        remarks = [*remarks, f"{path}: every light has a negative z; z is taken to point away from the camera"]
    lights, under = [], []
    for given, (x, y, z) in named:
        if turn * z <= 0:
            under.append(given.name)
            continue
        length = math.hypot(x, y, z)
        beside = not given.is_absolute() and ":" not in str(given) and len(given.parts) > 1
        folder = str(given.parent) if beside else ""
        unit = (x / length, y / length, turn * z / length)
        lights.append(LpLight(given.stem, unit, given.name, folder, length, path.parent))
    if not lights:
        raise InputError(f"{path}: has no light over the horizon; z points to the camera")
    if under:
        some = ", ".join(under[:3]) + (", …" if len(under) > 3 else "")
        plural = "light is" if len(under) == 1 else "lights are"
        remarks = [*remarks, f"{path}: {len(under)} {plural} at or under the horizon and left out ({some})"]
    return LightFile(path, lights, remarks)


def numbered(count: int) -> list[str]:
    """Return the names of lights whose photographs go by their order."""
    return [f"{k:03d}" for k in range(1, count + 1)]


def with_intensities(found: LightFile, light: Mapping[str, Vector]) -> LightFile:
    """Return the lights with the light of each lamp in R, G, B, by the name of its image."""
    return replace(found, lights=[replace(one, intensity=light[one.file]) for one in found.lights])
