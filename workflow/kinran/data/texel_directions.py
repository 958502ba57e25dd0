"""Directions of light and view at the texels, for lamps and a camera at finite distances or far away."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base import distances, frames
from kinran.data.radiance_stack import Box, Stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Index = NDArray[np.intp] | NDArray[np.bool_] | slice

BEND = 0.001
"""Largest turn of half vectors, in radians, from the middle of a cell of texels to its edge: a 20th of the narrowest
lobe that a fit allows (`kinran.fit.slope.NARROWEST`). In a field of one cell, lamps and camera count as far away."""
AFAR = (0.0, 0.0, 1e9)
"""Position, in millimetres, of a camera whose distance is unknown."""


@dataclass(frozen=True)
class Under:
    """Directions of light and view at texels, which those of one cell share.

    Attributes
    ----------
    directions : (light, 3)
        Unit directions of the lights from the field's centre.
    lights : (cell, light, 3)
        Unit directions of the lights from the middle of each cell.
    slopes : (cell, light, 2)
        Slopes of the half vectors of these lights and the cell's view.
    cell : (texel,) int
        Cell of each texel.
    falloff : (texel, light) float32 or None
        Irradiance at each texel on a plane that faces the lamp, relative to the field's centre; None where it is 1.
    """

    directions: Array
    lights: Array
    slopes: Array
    cell: NDArray[np.intp]
    falloff: Single | None = None

    @classmethod
    def far(cls, directions: ArrayLike, texels: int = 1) -> "Under":
        """Return the directions under lights (light, 3) and a camera far away: all texels are one cell."""
        lights = np.ascontiguousarray(directions, float)
        return cls(lights, lights[None], frames.slopes(lights)[None], np.zeros(texels, np.intp))

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self.directions)

    def cells(self) -> Iterator[tuple[int, Index]]:
        """Yield the cells that have texels, and the indices of these; a lone cell's as a slice, without a copy."""
        if len(self.lights) == 1:
            yield 0, slice(None)
            return
        for k in np.unique(self.cell):
            yield int(k), np.flatnonzero(self.cell == k)

    def of(self, texels: Index) -> "Under":
        """Return the directions at some of the texels."""
        kept, cell = self.cell[texels], self.cell[texels]
        lights, slopes = self.lights, self.slopes
        if len(lights) > 1:
            used, cell = np.unique(kept, return_inverse=True)
            lights, slopes = lights[used], slopes[used]
        return Under(self.directions, lights, slopes, cell, None if self.falloff is None else self.falloff[texels])

    def only(self, lights: Index) -> "Under":
        """Return the directions of some of the lights."""
        towards, slopes = (np.ascontiguousarray(part[:, lights]) for part in (self.lights, self.slopes))
        falloff = None if self.falloff is None else np.ascontiguousarray(self.falloff[:, lights])
        return Under(self.directions[lights], towards, slopes, self.cell, falloff)

    def reaching(self, T: Single) -> Single:
        """Return a stack's radiance (texel, 3, light) for T (texel, 3, light): with the lamps' falloff."""
        return T if self.falloff is None else T * self.falloff[:, None]

    def square_on(self, radiance: Single) -> Single:
        """Return T (texel, 3, light) of a stack's radiance (texel, 3, light): without the lamps' falloff."""
        return radiance if self.falloff is None else radiance / self.falloff[:, None]


def join(parts: Sequence[Under]) -> Under:
    """Join the directions at texels, one part after the other, under the same lamps."""
    first = parts[0]
    if all(len(part.lights) == 1 and part.falloff is None for part in parts):
        return replace(first, cell=np.zeros(sum(len(part.cell) for part in parts), np.intp))
    starts = np.cumsum([0, *(len(part.lights) for part in parts)])
    falloffs = [part.falloff for part in parts if part.falloff is not None]
    return Under(
        first.directions,
        np.concatenate([part.lights for part in parts]),
        np.concatenate([part.slopes for part in parts]),
        np.concatenate([part.cell + start for part, start in zip(parts, starts[:-1], strict=True)]),
        np.concatenate(falloffs),
    )


def matters(stack: Stack) -> bool:
    """Return whether positions are known and turn the half vectors over the field by more than `BEND`."""
    return stack.texel_mm is not None and max(stack.height, stack.width) * stack.texel_mm > _side(stack)


def under(stack: Stack, box: Box, lights: NDArray[np.intp]) -> Under:
    """Return the directions at a tile's texels under lights of the stack: one cell where distances do not matter."""
    y0, y1, x0, x1 = box
    if not matters(stack):
        return Under.far(stack.directions[lights], (y1 - y0) * (x1 - x0))
    assert stack.texel_mm
    points = distances.texel_points(stack.height, stack.width, stack.texel_mm)[y0:y1, x0:x1].reshape(-1, 3)
    positions = np.array([stack.lights[i].position_mm for i in lights], float)
    _, cell = np.unique(np.round(points[:, :2] / _side(stack)).astype(int), axis=0, return_inverse=True)
    middles = np.stack([points[cell.ravel() == k].mean(0) for k in range(cell.max() + 1)])
    towards = np.stack([distances.directions_to(positions, middle) for middle in middles])
    half = towards + distances.directions_to(stack.camera_mm or AFAR, middles)[:, None]
    falloff = distances.falloff(positions, points).T.astype(np.float32)
    return Under(stack.directions[lights], towards, half[..., :2] / half[..., 2:], cell.ravel(), falloff)


def _side(stack: Stack) -> float:
    """Return the side of a cell in millimetres; infinite where a lamp's position is unknown."""
    positions = [light.position_mm for light in stack.lights]
    if None in positions:
        return np.inf
    nearest = float(np.linalg.norm(np.array(positions, float), axis=1).min())
    closeness = 1 / nearest + (1 / stack.camera_mm[2] if stack.camera_mm else 0)
    return 4 * BEND / closeness
