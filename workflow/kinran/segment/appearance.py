"""Appearance of each texel over all training lights, and the colour space in which regions are told apart."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.data.radiance import SATURATED
from kinran.data.radiance_stack import Stack

Map = NDArray[np.float32]
Features = NDArray[np.float64]

LEAST_LIGHTS = 3
"""Fewest lights that a median is taken of: with three it passes over one odd sample."""


@dataclass(frozen=True)
class Appearance:
    """Statistics over the training lights.

    Attributes
    ----------
    median : (y, x, 3) float32
        Median of T / cos θ_i over lights within 60° of the normal, samples with a clipped channel left out.
    peak, middle : (y, x) float32
        98th and 40th percentile of luminance (mean of the channels), clipped samples included.
    inside : (y, x) bool
        Whether each texel is inside the mask of its set.
    """

    median: Map
    peak: Map
    middle: Map
    inside: NDArray[np.bool_]

    @property
    def shininess(self) -> Features:
        """Logarithm of the 98th over the 40th percentile, (y, x)."""
        return np.asarray(np.log((self.peak.astype(float) + 1e-4) / (self.middle.astype(float) + 1e-4)))

    def features(self) -> Features:
        """Log chroma (R/G, B/G), log luminance and shininess, each of unit spread; (texel, 4) of the texels inside.

        In one photograph threads differ by their shading; these features hold whatever way a thread faces.
        """
        median, peak, middle = (part[self.inside] for part in (self.median, self.peak, self.middle))
        floor = 1e-3 * max(float(np.percentile(median, 99)), 1e-6) + 1e-6
        m = np.log(np.maximum(median.astype(float), 0) + floor)
        shininess = np.log(np.maximum(peak, 0) + floor) - np.log(np.maximum(middle, 0) + floor)
        columns = np.stack([m[..., 0] - m[..., 1], m[..., 2] - m[..., 1], m.mean(-1), shininess], -1).reshape(-1, 4)
        spread = columns.std(0)
        return np.asarray((columns - columns.mean(0)) / np.where(spread > 1e-6, spread, 1.0))


def over_lights(stack: Stack) -> Appearance:
    """Appearance of a stack's texels, tile by tile."""
    use = np.flatnonzero(~stack.held_out)
    cosine = stack.directions[use, 2]
    high = cosine > 0.5 if (cosine > 0.5).sum() >= LEAST_LIGHTS else np.ones(len(cosine), bool)
    median = np.zeros((stack.height, stack.width, 3), np.float32)
    peak, middle = np.zeros(median.shape[:2], np.float32), np.zeros(median.shape[:2], np.float32)
    for y0, y1, x0, x1 in stack.tiles():
        seen = stack.read_tile(y0, y1, x0, x1, lights=use)
        radiance = np.nan_to_num(seen.value, posinf=0, neginf=0)
        clipped = seen[high].texels_with(SATURATED)
        median[y0:y1, x0:x1] = median_unclipped(radiance[high] / cosine[high, None, None, None], clipped)
        middle[y0:y1, x0:x1], peak[y0:y1, x0:x1] = np.percentile(radiance.mean(-1), (40, 98), axis=0)
    return Appearance(median, peak, middle, stack.inside)


def median_unclipped(values: Map, clipped: NDArray[np.bool_]) -> Map:
    """Median over lights (light, y, x, 3) of samples that are not clipped (light, y, x).

    Texels that have fewer than three of them keep the median of all.
    """
    result = np.asarray(np.median(values, axis=0), np.float32)
    some = clipped.any(0) & ((~clipped).sum(0) >= LEAST_LIGHTS)
    if some.any():
        kept = np.where(clipped[:, some][..., None], np.nan, values[:, some])
        result[some] = np.nanmedian(kept, axis=0)
    return result
