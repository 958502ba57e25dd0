"""Lights of a set: their directions and positions, and the grid that they may lie on."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
    """One light of a file of lights.

    Attributes
    ----------
    name
        Stem of the image's name.
    direction
        Unit vector at the field's centre, away from the surface.
    file
        Name of the image in the file; empty for a shot of the rig.
    folder
        Folder of the image that the file names, relative to its own or to that of its project; else empty.
    length
        Length of the vector in the file, which may be a position in a unit that it does not state.
    base
        Folder of the file.
    intensity
        Light of the lamp in R, G, B, in any unit; None where all are alike.
    """

    name: str
    direction: tuple[float, float, float]
    file: str = ""
    folder: str = ""
    length: float = field(default=1.0, compare=False)
    base: Path | None = field(default=None, compare=False)
    intensity: tuple[float, float, float] | None = None


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
