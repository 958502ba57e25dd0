"""Lamps and camera at finite distances: what they change for each texel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran import frames, geometry
from kinran.stack import Box, Stack

Array = NDArray[np.float64]

BEND = 0.001
"""Radians that half vectors may turn from the middle of a cell of texels to its edge, a 20th of the narrowest lobe that
is found. docs/fit.md has what larger cells cost (`tests/fit/test_near.py`). In a field of one cell, lamps and camera
are taken for far away."""
AFAR = (0.0, 0.0, 1e9)
"""Position in millimetres of a camera of which nothing is known: far above the field."""


@dataclass(frozen=True)
class Cell:
    """Texels of a tile that share their directions of light and view.

    Attributes
    ----------
    at : (texel,) int
        Places of the texels in the tile, counted along its rows.
    lights : (light, 3)
        Directions of the lights from the middle of the cell.
    slopes : (light, 2)
        Slopes of the half vectors between these and the view.
    factor : (texel, light) or None
        Light that reaches each texel, square on, relative to the field's centre: the stack's values are π·T times
        this. None where it is 1.
    """

    at: NDArray[np.intp]
    lights: Array
    slopes: Array
    factor: NDArray[np.float32] | None


def matters(stack: Stack) -> bool:
    """Whether positions are known and turn the half vectors over the field by more than `BEND`."""
    return stack.texel_mm is not None and max(stack.height, stack.width) * stack.texel_mm > _side(stack)


def cells(stack: Stack, box: Box, lights: NDArray[np.intp]) -> list[Cell]:
    """Cells of a tile under these lights of the stack; where distances do not matter, the whole tile is one cell."""
    y0, y1, x0, x1 = box
    count = (y1 - y0) * (x1 - x0)
    if not matters(stack):
        directions = stack.directions[lights]
        return [Cell(np.arange(count), directions, frames.slopes(directions), None)]
    assert stack.texel_mm
    points = geometry.texel_points(stack.height, stack.width, stack.texel_mm)[y0:y1, x0:x1].reshape(-1, 3)
    positions = np.array([stack.lights[i].position_mm for i in lights], float)
    _, cell = np.unique(np.round(points[:, :2] / _side(stack)).astype(int), axis=0, return_inverse=True)
    found = []
    for k in range(cell.max() + 1):
        at = np.flatnonzero(cell.ravel() == k)
        middle = points[at].mean(0)
        directions = geometry.directions_to(positions, middle)
        view = geometry.directions_to(stack.camera_mm or AFAR, middle)
        half = directions + view
        factor = geometry.falloff(positions, points[at]).T.astype(np.float32)
        found.append(Cell(at, directions, half[:, :2] / half[:, 2:], factor))
    return found


def _side(stack: Stack) -> float:
    """Millimetres of a cell's side; infinite where a lamp's position is not known."""
    positions = [light.position_mm for light in stack.lights]
    if None in positions:
        return np.inf
    nearest = float(np.linalg.norm(np.array(positions, float), axis=1).min())
    closeness = 1 / nearest + (1 / stack.camera_mm[2] if stack.camera_mm else 0)
    return 4 * BEND / closeness
