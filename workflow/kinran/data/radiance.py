"""Radiance: the light that was measured, what is wrong with a sample, and how well it is known."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]

SATURATED, DARK, HOT, SHIFTED = 1, 2, 4, 8
"""Bits of flags: no exposure was under saturation, so that the value is a lower bound; the value is under three
standard deviations of its noise; the site of the sensor is defective; the exposures disagree, since something moved."""


@dataclass(frozen=True)
class Radiance:
    """Samples of light, mostly those of one picture (y, x, 3).

    Attributes
    ----------
    value : (..., 3) float32
        Linear light of R, G, B; row 0 is the bottom. A merged bracket is in counts per second (of photographs: 65,535
        is white), a photograph in its encoding's white, and what goes to the stack in the stack's unit.
    flags : (..., 3) uint8
        What is wrong with each sample: bits `SATURATED`, `DARK`, `HOT`, `SHIFTED`.
    sigma : (..., 3) float32
        Standard deviation of `value`, infinite where every exposure is saturated; None where nobody asked for it, since
        it follows from the value and the noise model of the stack.
    """

    value: Image
    flags: Flags
    sigma: Image | None = None

    @classmethod
    def unflagged(cls, value: Image) -> "Radiance":
        """Samples (..., 3) with which nothing is wrong."""
        return cls(value, np.zeros(value.shape, np.uint8))

    def __getitem__(self, where: Any) -> "Radiance":
        """Some of the samples, by an index of NumPy."""
        return Radiance(self.value[where], self.flags[where], None if self.sigma is None else self.sigma[where])

    def has(self, bits: int) -> NDArray[np.bool_]:
        """Whether any of these bits is set in the flags of each sample (..., 3)."""
        return (self.flags & bits) > 0

    def texels_with(self, bits: int) -> NDArray[np.bool_]:
        """Whether any of these bits is set in any channel of each texel (...)."""
        return np.asarray(self.has(bits).any(-1))

    def with_value(self, value: Image) -> "Radiance":
        """The same samples with another value, of which σ is not known."""
        return replace(self, value=value, sigma=None)
