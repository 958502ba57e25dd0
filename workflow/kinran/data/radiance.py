"""Radiance: measured light with its flags and standard deviations."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]

SATURATED, DARK, HOT, SHIFTED, OUTSIDE = 1, 2, 4, 8, 16
"""Bits of the flags: every exposure is saturated, so that the value is a lower bound; the value is under three standard
deviations of its noise; the site of the sensor is defective, or there is no sample; the exposures disagree, since
something moved; the texel is outside the mask of its set, so that it is `HOT` under every light, and not filled."""


@dataclass(frozen=True)
class Radiance:
    """Samples of light, usually those of one picture (y, x, 3).

    Attributes
    ----------
    value : (..., 3) float32
        Linear light of R, G, B; row 0 is the bottom. The unit of a merged bracket is counts per second (photographs'
        white is 65,535 counts), that of a photograph its encoding's white, and that of a stack `Stack.unit`.
    flags : (..., 3) uint8
        Flags of each sample: bits `SATURATED`, `DARK`, `HOT`, `SHIFTED`, `OUTSIDE`.
    sigma : (..., 3) float32
        Standard deviation of `value`, infinite where every exposure is saturated; None where it was not computed, since
        it follows from the value and the stack's noise model.
    """

    value: Image
    flags: Flags
    sigma: Image | None = None

    @classmethod
    def unflagged(cls, value: Image) -> "Radiance":
        """Return samples (..., 3) without flags."""
        return cls(value, np.zeros(value.shape, np.uint8))

    def __getitem__(self, where: Any) -> "Radiance":
        """Return some of the samples, by a NumPy index."""
        return Radiance(self.value[where], self.flags[where], None if self.sigma is None else self.sigma[where])

    def has(self, bits: int) -> NDArray[np.bool_]:
        """Return whether any of these bits is set in the flags of each sample (..., 3)."""
        return (self.flags & bits) > 0

    def texels_with(self, bits: int) -> NDArray[np.bool_]:
        """Return whether any of these bits is set in any channel of each texel (...)."""
        return np.asarray(self.has(bits).any(-1))

    def only(self, inside: NDArray[np.bool_]) -> "Radiance":
        """Return a picture (y, x, 3) that has no samples outside a mask (y, x)."""
        where = inside[..., None]
        return Radiance(np.where(where, self.value, 0), np.where(where, self.flags, np.uint8(HOT | OUTSIDE)))

    def with_value(self, value: Image) -> "Radiance":
        """Return the same samples with other values (..., 3) and without σ."""
        return replace(self, value=value, sigma=None)
