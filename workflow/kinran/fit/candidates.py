"""The kinds of lobes that a fabric may have, and their fits to a sample of its texels."""

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
"""Function from linear light to displayed values: the encoding of photographs, or a logarithm of radiance."""

DB_A_BYTE = 0.3 / 16
"""PSNR in dB that a byte per texel has to gain in cross-validation: 0.3 dB for the 16 bytes of a lobe. `kinran bench
choice` compares other gains (docs/fit.md, "The simplest lobes")."""


@dataclass(frozen=True)
class Candidate:
    """A kind of material: its name, its lobes (None for a diffuse term alone), and its numbers per texel."""

    name: str
    lobes: Lobes | None
    numbers: int

    @property
    def size(self) -> int:
        """Bytes per texel at half precision."""
        return 2 * self.numbers

    def priors(self, samples: Samples, threads: int) -> list[Prior] | None:
        """Priors of the regions, learned from a sample of their texels; None without lobes."""
        if self.lobes is None:
            return None
        return learned_priors.learn_priors(samples, int(samples.region.max()) + 1, self.lobes, threads)

    def predicted(self, samples: Samples, priors: list[Prior] | None, under: Under, threads: int) -> Single:
        """T (texel, 3, light) that a fit to the samples under these priors predicts under some lights."""
        if self.lobes is None:
            return lambert.fit(samples).predict(under)
        return slope.fit(samples, self.lobes, priors, threads).predict(under)


CANDIDATES = (
    Candidate("lambert", None, 5),
    Candidate("one GGX lobe", Lobes("ggx", 1), 13),
    Candidate("two Gaussian lobes", Lobes("gaussian", 2), 21),
)


def display(stack: Stack, T: Single) -> Display:
    """Function that displays the light of a stack.

    Parameters
    ----------
    T : (texel, 3, light) float32
        Sample of the stack's light, whose 99.9th percentile is shown as white.
    """
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    peak = float(np.percentile(T, 99.9)) or 1.0
    return lambda light: metrics.to_display(light, coder, peak)
