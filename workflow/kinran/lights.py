"""The lights of a set: names and directions, and the `.lp` files in which they come."""

import math
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from kinran.files import InputError


@dataclass(frozen=True)
class Light:
    """One light of a set.

    Attributes
    ----------
    name
        Stem of its image, or of its shot.
    direction
        Unit vector at the field's centre, away from the surface.
    file
        Name of its image as the `.lp` gives it; empty for a shot of the rig.
    """

    name: str
    direction: tuple[float, float, float]
    file: str = ""


def directions(lights: list[Light]) -> NDArray[np.float64]:
    """Unit directions of lights, (n, 3)."""
    return np.array([light.direction for light in lights], float).reshape(-1, 3)


def read_lp(path: Path) -> list[Light]:
    """Read a `.lp` file: the number of lights, then a line ``file x y z`` for each.

    File names may hold spaces and folders (either slash); only the last part counts. Vectors of any length
    are accepted and normalised.

    Raises
    ------
    InputError
        The count is wrong, a vector is zero, not finite or under the horizon, or a name stands twice.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a text file of light positions") from None
    rows = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip()]
    if not rows or len(rows[0][1]) != 1 or not rows[0][1][0].isdigit():
        raise InputError(f"{path}: the first line is not the number of lights; a .lp starts with it")
    count, rows = int(rows[0][1][0]), rows[1:]
    if count != len(rows):
        raise InputError(f"{path}: the first line says {count} lights but {len(rows)} follow; correct one")
    lights: list[Light] = []
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


def _parse(path: Path, number: int, words: list[str]) -> Light:
    file = PurePosixPath(" ".join(words[:-3]).replace("\\", "/")).name
    try:
        x, y, z = (float(word) for word in words[-3:])
    except ValueError:
        file = ""
    if not file:
        raise InputError(f"{path}: line {number} is not 'file x y z': {' '.join(words)!r}")
    length = math.hypot(x, y, z)
    if not math.isfinite(length) or length == 0:
        raise InputError(f"{path}: line {number} ({file}) has the light vector {x} {y} {z}; give a direction")
    if z <= 0:
        raise InputError(
            f"{path}: line {number} ({file}) has a light under the horizon (z = {z:g}); z points to the camera"
        )
    return Light(PurePosixPath(file).stem, (x / length, y / length, z / length), file)


def write_lp(path: Path, lights: list[Light]) -> None:
    """Write a `.lp` file."""
    rows = [f"{light.file or light.name} {' '.join(f'{v:.9f}' for v in light.direction)}" for light in lights]
    path.write_text("\n".join([str(len(lights)), *rows]) + "\n", encoding="utf-8")


def lp_file(folder: Path) -> Path:
    """The one `.lp` file of a folder.

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
