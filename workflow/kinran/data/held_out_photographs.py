"""Photographs under the held-out lights, by which materials and methods are judged."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.data import metrics
from kinran.data.radiance import HOT, SATURATED, SHIFTED
from kinran.data.radiance_stack import Box, Light, Stack

Images = NDArray[np.float32]


@dataclass(frozen=True)
class HeldOut:
    """Photographs under the held-out lights.

    Attributes
    ----------
    lights
        Held-out lights.
    use : (light,) int
        Indices of these lights in the stack.
    truth : (light, y, x, 3) float32
        Measured radiance in the stack's unit; 0 where `valid` is 0.
    valid : (light, y, x, 3) float32
        1 for sound samples; 0 for defective and shifted ones and, in radiance, saturated ones.
    coder
        Encoding of photographs; None for radiance.
    peak
        99.9th percentile of the truth.
    """

    lights: list[Light]
    use: NDArray[np.intp]
    truth: Images
    valid: Images
    coder: encoding.Encoding | None
    peak: float

    @classmethod
    def read(cls, stack: Stack, box: Box | None = None) -> "HeldOut":
        """Read the held-out photographs of a stack, or of a box (y0, y1, x0, x1) of its texels."""
        use = np.flatnonzero(stack.held_out)
        top, bottom, left, right = box or (0, stack.height, 0, stack.width)
        truth = np.zeros((len(use), bottom - top, right - left, 3), np.float32)
        valid = np.zeros_like(truth)
        bad = HOT | SHIFTED | (0 if stack.encoding else SATURATED)
        for y0, y1, x0, x1 in [box] if box else stack.tiles():
            seen = stack.read_tile(y0, y1, x0, x1, lights=use)
            ok = ~seen.has(bad) & np.isfinite(seen.value)
            at = np.s_[:, y0 - top : y1 - top, x0 - left : x1 - left]
            valid[at] = ok
            truth[at] = np.where(ok, seen.value, 0)
        coder = encoding.parse(stack.encoding) if stack.encoding else None
        return cls([stack.lights[i] for i in use], use, truth, valid, coder, float(np.percentile(truth, 99.9)) or 1.0)

    @property
    def share(self) -> NDArray[np.float64]:
        """Relative solid angle (light,) that each light of a grid stands for, sin θ; 1 for the lights of a list."""
        if not all(light.grid for light in self.lights):
            return np.ones(len(self.lights))
        return np.array([max(1 - light.direction[2] ** 2, 0.0) ** 0.5 for light in self.lights])

    def shown(self, light: Images) -> Images:
        """Return light as values for display, as `metrics.to_display` does."""
        return metrics.to_display(light, self.coder, self.peak)
