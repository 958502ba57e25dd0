"""Directions under which texels are seen: lamps and camera at finite distances, or far away."""

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
"""Radians that half vectors may turn from the middle of a cell of texels to its edge: a 20th of the narrowest lobe that
a fit allows (`kinran.fit.slope.NARROWEST`). A field of one cell is taken as if lamps and camera were far."""
AFAR = (0.0, 0.0, 1e9)
"""Position of a camera, in millimetres, whose distance is unknown."""


@dataclass(frozen=True)
class Under:
    """Light and view of texels: texels of one cell share their directions.

    Attributes
    ----------
    directions : (light, 3)
        Unit directions of the lights from the field's centre.
    lights : (cell, light, 3)
        Unit directions of the lights from the middle of each cell.
    slopes : (cell, light, 2)
        Slopes of the half vectors between these and the view.
    cell : (texel,) int
        Cell of each texel.
    falloff : (texel, light) float32 or None
        Light that reaches each texel, square on, relative to the field's centre; None where it is 1.
    """

    directions: Array
    lights: Array
    slopes: Array
    cell: NDArray[np.intp]
    falloff: Single | None = None

    @classmethod
    def far(cls, directions: ArrayLike, texels: int = 1) -> "Under":
        """Lights (light, 3) and camera that are far away: all texels are one cell."""
        lights = np.ascontiguousarray(directions, float)
        return cls(lights, lights[None], frames.slopes(lights)[None], np.zeros(texels, np.intp))

    @property
    def count(self) -> int:
        """Number of lights."""
        return len(self.directions)

    def cells(self) -> Iterator[tuple[int, Index]]:
        """Cells that have texels, and the places of these; of a lone cell as a slice, which copies nothing."""
        if len(self.lights) == 1:
            yield 0, slice(None)
            return
        for k in np.unique(self.cell):
            yield int(k), np.flatnonzero(self.cell == k)

    def of(self, texels: Index) -> "Under":
        """Directions of some of the texels."""
        kept, cell = self.cell[texels], self.cell[texels]
        lights, slopes = self.lights, self.slopes
        if len(lights) > 1:
            used, cell = np.unique(kept, return_inverse=True)
            lights, slopes = lights[used], slopes[used]
        return Under(self.directions, lights, slopes, cell, None if self.falloff is None else self.falloff[texels])

    def only(self, lights: Index) -> "Under":
        """Directions of some of the lights."""
        towards, slopes = (np.ascontiguousarray(part[:, lights]) for part in (self.lights, self.slopes))
        falloff = None if self.falloff is None else np.ascontiguousarray(self.falloff[:, lights])
        return Under(self.directions[lights], towards, slopes, self.cell, falloff)

    def reaching(self, T: Single) -> Single:
        """What the stack holds of texels that show T (texel, 3, light): with the falloff of the lamps."""
        return T if self.falloff is None else T * self.falloff[:, None]

    def square_on(self, radiance: Single) -> Single:
        """T (texel, 3, light) of radiance that a stack holds: without the falloff of the lamps."""
        return radiance if self.falloff is None else radiance / self.falloff[:, None]


def join(parts: Sequence[Under]) -> Under:
    """Directions of texels one part after the other, under the same lamps."""
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
    """Whether positions are known and turn the half vectors over the field by more than `BEND`."""
    return stack.texel_mm is not None and max(stack.height, stack.width) * stack.texel_mm > _side(stack)


def under(stack: Stack, box: Box, lights: NDArray[np.intp]) -> Under:
    """Directions of a tile under these lights of the stack: one cell, far away, where distances do not matter."""
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
    """Millimetres of a cell's side; infinite where a lamp's position is not known."""
    positions = [light.position_mm for light in stack.lights]
    if None in positions:
        return np.inf
    nearest = float(np.linalg.norm(np.array(positions, float), axis=1).min())
    closeness = 1 / nearest + (1 / stack.camera_mm[2] if stack.camera_mm else 0)
    return 4 * BEND / closeness
