"""The lights of a set: their directions and positions, the grid that they may lie on, and `.lp` files."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError

SUFFIX = re.compile(r"[.][A-Za-z]{3,4}[\"']?$")
"""Pattern of an image's suffix at the end of a word."""
SCATTERED = 5.0, 15.0
"""Degrees in θ_i and φ_i within which lights that lie on no grid count as one row and one meridian: a choice that finds
a few lights in RTI domes of 30 to 100. No measurement stands behind it."""


@dataclass(frozen=True)
class Light:
    """One light of a set.

    Attributes
    ----------
    name
        Name of its shot or photograph.
    direction
        Unit vector from the field's centre, away from the surface.
    position_mm
        Position of the lamp in millimetres from the field's centre; None when unknown.
    grid
        (iθ, iφ) in the plan's grid; None in a list.
    held_out
        Whether the light is kept from every fit, for evaluation.
    """

    name: str
    direction: tuple[float, float, float]
    position_mm: tuple[float, float, float] | None = None
    grid: tuple[int, int] | None = None
    held_out: bool = False


@dataclass(frozen=True)
class LpLight:
    """One light of a `.lp` file.

    Attributes
    ----------
    name
        Stem of the image's name.
    direction
        Unit vector at the field's centre, away from the surface.
    file
        Name of the image in the `.lp`; empty for a shot of the rig.
    folder
        Folder of the image relative to that of the `.lp`, where the `.lp` names one beside it; else empty.
    length
        Length of the vector in the `.lp`, which may be a position in a unit that the file does not state.
    """

    name: str
    direction: tuple[float, float, float]
    file: str = ""
    folder: str = ""
    length: float = field(default=1.0, compare=False)


def directions(lights: Sequence[Light | LpLight]) -> NDArray[np.float64]:
    """Return the unit directions (n, 3) of lights."""
    return np.array([light.direction for light in lights], float).reshape(-1, 3)


def half_steps(lights: Sequence[Light]) -> tuple[float, float]:
    """Return half a step in θ_i and φ_i, in radians, of the grid of all lights; `SCATTERED` where there is no grid.

    φ gets 2 % more: with an odd number of meridians, both neighbours of the opposite azimuth count.
    """
    grid = [light.grid for light in lights if light.grid]
    if len(grid) < len(lights):
        return math.radians(SCATTERED[0]), math.radians(SCATTERED[1])
    thetas = np.unique(np.round(np.degrees(np.arccos(directions(lights)[:, 2])), 3))
    azimuths = max(phi for _, phi in grid) + 1
    return float(np.radians(0.5 * np.median(np.diff(thetas)))), 1.02 * math.pi / azimuths


def read_lp(path: Path) -> list[LpLight]:
    """Read a `.lp` file: the number of lights, then a line ``file x y z`` for each.

    File names may hold spaces, quotes and folders (either slash); folders of another machine are ignored. Lines that
    begin with # are comments. Vectors may have any length, which is kept beside their direction.

    Raises
    ------
    InputError
        The file cannot be read, the count is wrong, a vector is zero, not finite or under the horizon, a line has more
        numbers than a vector, or a name stands twice.
    """
    try:
        lines = _text(path.read_bytes()).splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a text file of light positions") from None
    numbered = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip()]
    rows = [(number, words) for number, words in numbered if not words[0].startswith("#") or _is_vector(words[-3:])]
    if not rows or len(rows[0][1]) != 1 or not rows[0][1][0].isdigit():
        raise InputError(f"{path}: the first line is not the number of lights; a .lp starts with it")
    count, rows = int(rows[0][1][0]), rows[1:]
    if count != len(rows):
        raise InputError(f"{path}: the first line says {count} lights but {len(rows)} follow; correct one")
    lights: list[LpLight] = []
    seen: dict[str, int] = {}
    for number, words in rows:
        light = _parse(path, number, words)
        if light.name in seen:
            raise InputError(
                f"{path}: line {number} names '{light.name}' again (first in line {seen[light.name]});"
                " give each image one light"
            )
        seen[light.name] = number
        lights.append(light)
    return lights


def _text(data: bytes) -> str:
    """Decode UTF-8, UTF-16 with a byte order mark, or else Windows-1252."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")


def _is_vector(words: list[str]) -> bool:
    try:
        return len([float(word) for word in words]) == 3
    except ValueError:
        return False


def _parse(path: Path, number: int, words: list[str]) -> LpLight:
    given = PurePosixPath(" ".join(words[:-3]).strip("\"'").replace("\\", "/"))
    if not given.name or not _is_vector(words[-3:]):
        raise InputError(f"{path}: line {number} is not 'file x y z': {' '.join(words)!r}")
    if any(SUFFIX.search(word) for word in words[:-4]) and _is_vector(words[-4:-1]):
        raise InputError(f"{path}: line {number} has more than three numbers: {' '.join(words)!r}; give 'file x y z'")
    file, beside = given.name, not given.is_absolute() and ":" not in str(given) and ".." not in given.parts
    x, y, z = (float(word) for word in words[-3:])
    length = math.hypot(x, y, z)
    if not math.isfinite(length) or length == 0:
        raise InputError(f"{path}: line {number} ({file}) has the light vector {x} {y} {z}; give a direction")
    if z <= 0:
        raise InputError(
            f"{path}: line {number} ({file}) has a light under the horizon (z = {z:g}), but z points to the camera;"
            " correct it, or take the line out"
        )
    folder = str(given.parent) if beside and len(given.parts) > 1 else ""
    return LpLight(given.stem, (x / length, y / length, z / length), file, folder, length)


def write_lp(path: Path, lights: list[LpLight]) -> None:
    """Write a `.lp` file: directions times lengths."""
    vectors = [[light.length * part for part in light.direction] for light in lights]
    rows = [f"{a.file or a.name} {' '.join(f'{part:.9f}' for part in v)}" for a, v in zip(lights, vectors, strict=True)]
    path.write_text("\n".join([str(len(lights)), *rows]) + "\n", encoding="utf-8")


def lp_file(folder: Path) -> Path:
    """Return the only `.lp` file of a folder.

    Raises
    ------
    InputError
        The folder is missing, or has none or several.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".lp")
    if not found:
        raise InputError(f"{folder}: has no .lp file; add one with the number of lights and 'file x y z' for each")
    if len(found) > 1:
        raise InputError(f"{folder}: has {found[0].name} and {found[1].name}; keep one .lp file")
    return found[0]
