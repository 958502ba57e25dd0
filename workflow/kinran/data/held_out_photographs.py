"""Photographs under the held-out lights, by which materials and methods are judged."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.data import metrics
from kinran.data.radiance import HOT, SATURATED, SHIFTED
from kinran.data.radiance_stack import Box, Light, Stack

Images = NDArray[np.float32]

PEAK = 99.9
"""Percentile of the truth that is the peak of values for display: a few glints are over it. A choice."""


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
    full : (light, y, x, 3) bool
        Whether a sample of a photograph is saturated, so that its light was that or more.
    coder
        Encoding of photographs; None for radiance.
    peak
        99.9th percentile of the truth.
    """

    lights: list[Light]
    use: NDArray[np.intp]
    truth: Images
    valid: Images
    full: NDArray[np.bool_]
    coder: encoding.Encoding | None
    peak: float

    @classmethod
    def read(cls, stack: Stack, box: Box, peak: float | None = None) -> "HeldOut":
        """Read the held-out photographs of a box (y0, y1, x0, x1) of a stack; with its own peak, if none is given."""
        use = np.flatnonzero(stack.held_out)
        bad = HOT | SHIFTED | (0 if stack.encoding else SATURATED)
        seen = stack.read_tile(*box, lights=use)
        valid = ~seen.has(bad) & np.isfinite(seen.value)
        truth = np.where(valid, seen.value, np.float32(0))
        coder = encoding.parse(stack.encoding) if stack.encoding else None
        own = peak or float(np.percentile(truth, PEAK)) or 1.0
        full = valid & seen.has(SATURATED)
        return cls([stack.lights[i] for i in use], use, truth, valid.astype(np.float32), full, coder, own)

    def allowed(self, predicted: Images) -> Images:
        """Return a prediction with what exceeds a saturated sample lowered to it, as it may well be right there."""
        return np.where(self.full, np.minimum(predicted, self.truth), predicted)

    @property
    def share(self) -> NDArray[np.float64]:
        """Relative solid angle (light,) that each light stands for; see `share_of`."""
        return share_of(self.lights)

    def shown(self, light: Images) -> Images:
        """Return light as values for display, as `metrics.to_display` does."""
        return metrics.to_display(light, self.coder, self.peak)


def share_of(lights: list[Light]) -> NDArray[np.float64]:
    """Return the relative solid angle (light,) that each light of a grid stands for, sin θ; 1 for those of a list."""
    if not all(light.grid for light in lights):
        return np.ones(len(lights))
    return np.array([max(1 - light.direction[2] ** 2, 0.0) ** 0.5 for light in lights])


@dataclass(frozen=True)
class Survey:
    """What is known of the held-out photographs of a stack when all of them were seen once.

    Attributes
    ----------
    lights
        Held-out lights.
    share : (light,) float
        Relative solid angle that each stands for.
    peak
        99.9th percentile of the radiance of all.
    mean : (light,) float
        Mean radiance of each.
    """

    lights: list[Light]
    share: NDArray[np.float64]
    peak: float
    mean: NDArray[np.float64]


def survey(stack: Stack) -> Survey:
    """Survey the held-out photographs of a stack inside its mask, of which a tile is in memory at a time.

    Half precision has 65,536 values: the percentile is that of how often each occurs, and exact.
    """
    lights = [light for light in stack.lights if light.held_out]
    counts, total = np.zeros(1 << 16, np.int64), np.zeros(len(lights))
    for box in stack.tiles():
        truth = HeldOut.read(stack, box, 1.0).truth[:, stack.inside[box[0] : box[1], box[2] : box[3]]]
        counts += np.bincount(truth.astype(np.float16).view(np.uint16).ravel(), minlength=len(counts))
        total += truth.sum((1, 2), dtype=float)
    mean = total / (stack.inside.sum() * 3)
    return Survey(lights, share_of(lights), _percentile(counts, PEAK) or 1.0, mean)


def _percentile(counts: NDArray[np.int64], percent: float) -> float:
    """Return a percentile of half floats, of which so many (65536,) have each pattern of bits; linear between two."""
    patterns = np.flatnonzero(counts).astype(np.uint16)
    values = patterns.view(np.float16).astype(float)
    order = np.argsort(values)
    last = np.cumsum(counts[patterns[order]]) - 1
    place = percent / 100 * last[-1]
    below, above = (values[order][np.searchsorted(last, rank)] for rank in (np.floor(place), np.ceil(place)))
    return float(below + (above - below) * (place - np.floor(place)))
