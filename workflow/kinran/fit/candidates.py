"""The lobes that a fabric may have, and fits of them to a sample of its texels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.data import metrics
from kinran.data.radiance_stack import Stack
from kinran.data.texel_directions import Under
from kinran.fit import lambert, learned_priors, slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

Single = NDArray[np.float32]
Display = Callable[[Single], Single]
"""From light to the values that are shown: of photographs their own, of radiance a logarithm."""

DB_A_BYTE = 0.3 / 16
"""What a byte a texel has to gain in cross-validated PSNR: 0.3 dB a lobe, which has 16 bytes."""


@dataclass(frozen=True)
class Candidate:
    """A kind of material: its name, its lobes or None for a diffuse term alone, and its numbers a texel."""

    name: str
    lobes: Lobes | None
    numbers: int

    @property
    def size(self) -> int:
        """Bytes a texel, at half precision."""
        return 2 * self.numbers

    def priors(self, samples: Samples, threads: int) -> list[Prior] | None:
        """Priors of the regions of a sample; None without lobes."""
        if self.lobes is None:
            return None
        return learned_priors.learn_priors(samples, int(samples.region.max()) + 1, self.lobes, threads)

    def predicted(self, samples: Samples, priors: list[Prior] | None, under: Under, threads: int) -> Single:
        """T (texel, 3, light) under some lights, of a fit to the samples under priors."""
        if self.lobes is None:
            return lambert.fit(samples).predict(under)
        return slope.fit(samples, self.lobes, priors, threads).predict(under)


CANDIDATES = (
    Candidate("lambert", None, 3),
    Candidate("one GGX lobe", Lobes("ggx", 1), 13),
    Candidate("two Gaussian lobes", Lobes("gaussian", 2), 21),
)


def display(stack: Stack, T: Single) -> Display:
    """How a stack's light is shown."""
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    peak = float(np.percentile(T, 99.9)) or 1.0
    return lambda light: metrics.to_display(light, coder, peak)
