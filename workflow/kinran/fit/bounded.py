"""A fit gone over with saturated samples as what they are: lower bounds, no values.

Where many samples of a texel are saturated, its peak is lost, and two Gaussian lobes are more than the flanks can tell:
they are made of one GGX lobe under its region's prior.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.start import HEIGHTS, pair

ROUNDS = 3
"""Fits in which saturated samples are raised to what the last one says. A choice; more were not measured."""
LOST = (0.05, 0.5)
"""Shares of saturated samples between which one lobe is better than two. Of more, no lobe is found."""


def refit(fitted: SlopeFit, samples: Samples, priors: list[Prior] | None = None, threads: int = 1) -> SlopeFit:
    """Fit texels with saturated samples again, taking what the last fit says above a bound for the sample.

    Parameters
    ----------
    fitted
        Of all texels, as `kinran.fit.slope.fit` gave it; saturated samples had little or no weight.
    samples
        With their `bounds`; without any the fit is as it was.
    """
    if samples.bounds is None:
        return fitted
    saturated = samples.bounds > 0
    share = saturated.sum(1) / np.maximum((saturated | (samples.W > 0)).sum(1), 1)
    lone = [prior.lone for prior in priors or () if prior.lone]
    lost = (share > LOST[0]) & (share <= LOST[1]) & bool(lone)
    result = replace(fitted, shapes=fitted.shapes.copy(), colours=fitted.colours.copy(), cost=fitted.cost.copy())
    at = np.flatnonzero((share > 0) & ~lost)
    if len(at):
        some = samples.of(at)
        result.put(at, _raised(fitted.of(at), some, saturated[at], priors, threads))
    at = np.flatnonzero(lost)
    if len(at):
        some = samples.of(at).unshared()
        one = slope.fit(some, Lobes("ggx", 1), lone, threads)
        result.put(at, as_pair(_raised(one, some, saturated[at], lone, threads), fitted.lobes))
    return result


def _raised(
    fitted: SlopeFit, samples: Samples, saturated: NDArray[np.bool_], priors: list[Prior] | None, threads: int
) -> SlopeFit:
    """Fit again and again with saturated samples (texel, light) at what the last fit says, and at least as bright."""
    assert samples.bounds is not None
    W = np.where(saturated, samples.bounds, samples.W).astype(np.float32)
    for _ in range(ROUNDS):
        T = np.where(saturated[:, None], np.maximum(samples.T, fitted.predict(samples.under)), samples.T)
        filled = replace(samples, T=T.astype(np.float32), W=W)
        fitted = slope.fit(filled, fitted.lobes, priors, threads, start=fitted.shapes)
    return fitted


def as_pair(fitted: SlopeFit, lobes: Lobes) -> SlopeFit:
    """Two Gaussian lobes of each one of GGX."""
    shapes = np.concatenate([fitted.lobe(0), fitted.shapes], 1)
    for p in shapes:
        pair(p)
    lobe, diffuse = fitted.colours[:, :1], fitted.colours[:, 1:]
    colours = np.concatenate([HEIGHTS[0] * lobe, HEIGHTS[1] * lobe, diffuse], 1)
    return SlopeFit(lobes, shapes, colours, fitted.cost)
