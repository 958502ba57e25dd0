"""The kinds of lobes that a fabric may have, and fits of them to a sample of its texels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran import encoding, metrics
from kinran.fit import lambert, learned, slope
from kinran.fit.predict import predict
from kinran.stack import Stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Labels = NDArray[np.intp]
Display = Callable[[Single], Single]
"""From light to the values that are shown: of photographs their own, of radiance a logarithm."""

DB_A_BYTE = 0.3 / 16
"""What a byte a texel has to gain in cross-validated PSNR: 0.3 dB a lobe, which has 16 bytes."""


@dataclass(frozen=True)
class Candidate:
    """A kind of material: its name, tail, number of lobes, and numbers a texel."""

    name: str
    tail: str
    lobes: int
    numbers: int

    @property
    def size(self) -> int:
        """Bytes a texel, at half precision."""
        return 2 * self.numbers


CANDIDATES = (
    Candidate("lambert", "ggx", 0, 3),
    Candidate("one GGX lobe", "ggx", 1, 13),
    Candidate("two Gaussian lobes", "gaussian", 2, 21),
)


@dataclass(frozen=True)
class Sampled:
    """Texels that a choice is made on.

    Attributes
    ----------
    T, W : (texel, 3, light), (texel, light) float32
        Under the training lights.
    lights : (light, 3)
    region, second : (texel,) int
        As `kinran.fit.slope.fit` takes them.
    shown
        How light is displayed.
    """

    T: Single
    W: Single
    lights: Array
    region: Labels
    second: Labels
    shown: Display

    def under(self, use: NDArray[np.bool_]) -> "Sampled":
        """Under some of the lights."""
        T, W = np.ascontiguousarray(self.T[:, :, use]), np.ascontiguousarray(self.W[:, use])
        return Sampled(T, W, self.lights[use], self.region, self.second, self.shown)

    def of(self, at: Labels) -> "Sampled":
        """Some of the texels."""
        return Sampled(self.T[at], self.W[at], self.lights, self.region[at], self.second[at], self.shown)

    def usable(self) -> NDArray[np.bool_]:
        """Samples (texel, 3, light) that count."""
        return (self.W > 0)[:, None] & np.isfinite(self.T)

    def priors(self, candidate: Candidate, threads: int) -> list[slope.Prior] | None:
        """Priors of the regions for a candidate with lobes."""
        if not candidate.lobes:
            return None
        count = int(self.region.max()) + 1
        kind = candidate.tail, candidate.lobes, threads
        return learned.learn_priors(self.T, self.W, self.lights, self.region, count, *kind)


def fitted(candidate: Candidate, sample: Sampled, others: Array, threads: int) -> Single:
    """T (texel, 3, light) under other lights, of a fit to those of the sample."""
    return fit(candidate, sample, others, sample.priors(candidate, threads), threads)


def fit(
    candidate: Candidate,
    sample: Sampled,
    others: Array,
    priors: list[slope.Prior] | None,
    threads: int,
    slopes: Array | None = None,
) -> Single:
    """`fitted` under priors that are known; `slopes` are those of the half vectors where the view is not N."""
    if not candidate.lobes:
        return (lambert.fit(sample.T, sample.W, sample.lights)[:, :, None] * others[:, 2]).astype(np.float32)
    kind = candidate.tail, candidate.lobes, priors, sample.region, threads
    found = slope.fit(sample.T, sample.W, sample.lights, *kind, slopes=slopes, second=sample.second)
    return predict(found, others, candidate.tail, slopes)


def display(stack: Stack, T: Single) -> Display:
    """How a stack's light is shown."""
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    peak = float(np.percentile(T, 99.9)) or 1.0
    return lambda light: metrics.to_display(light, coder, peak)
