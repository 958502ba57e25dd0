"""Refit texels with saturated samples, which are lower bounds and not values.

Where many samples of a texel are saturated, its peak is lost, and the flanks cannot tell two Gaussian lobes apart: the
two are then made from one GGX lobe that is fitted under its region's prior.
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
"""Fits in which saturated samples are raised to the last prediction. A choice; more rounds were not measured."""
SETTLED = 0.003
"""Rise of a saturated sample in a round, over the brightest sample of its texel, beneath which a texel is left as it
is. With 0.01 the errors of docs/fit.md, "Few exposures", are up to 1.3 % larger."""
LOST = (0.05, 0.5)
"""Shares of saturated samples between which one lobe is better than two; beyond the larger share no lobe is found. The
table is in docs/fit.md, "Few exposures"."""


def refit(fitted: SlopeFit, samples: Samples, priors: list[Prior] | None = None, threads: int = 1) -> SlopeFit:
    """Fit texels with saturated samples again, with the prediction for each sample that is above its bound.

    Parameters
    ----------
    fitted
        Fit of all texels by `kinran.fit.slope.fit`, in which saturated samples had little or no weight.
    samples
        Samples of the same texels. Without `bounds` the fit is returned as it is.
    priors
        A prior for each region.
    """
    if samples.bounds is None:
        return fitted
    saturated = samples.bounds > 0
    share = saturated.sum(1) / np.maximum((saturated | (samples.W > 0)).sum(1), 1)
    lone = [prior.lone for prior in priors or () if prior.lone]
    lost = (share > LOST[0]) & (share <= LOST[1]) & bool(lone)
    result = fitted.copy()
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
    """Repeat the fit with each saturated sample (texel, light) raised to the last prediction, where that is larger."""
    assert samples.bounds is not None
    W = np.where(saturated, samples.bounds, samples.W).astype(np.float32)
    filled, result, at = replace(samples, T=samples.T.copy(), W=W), fitted.copy(), np.arange(len(samples))
    for k in range(ROUNDS):
        T = np.maximum(samples.T[at], result.of(at).predict(samples.of(at).under))
        T = np.where(saturated[at][:, None], T, samples.T[at]).astype(np.float32)
        rising = np.abs(T - filled.T[at]).max((1, 2)) > SETTLED * T.max((1, 2))
        if k:  # at first also those whose bounds count from now on
            at, T = at[rising], T[rising]
        if not len(at):
            break
        filled.T[at] = T
        some = filled.of(at)
        result.put(at, slope.fit(some, fitted.lobes, priors, threads, start=result.shapes[at]))
    return result


def as_pair(fitted: SlopeFit, lobes: Lobes) -> SlopeFit:
    """Replace the one GGX lobe of each texel by two Gaussian lobes (docs/fit.md has the formula)."""
    shapes = np.concatenate([fitted.lobe(0), fitted.shapes], 1)
    for p in shapes:
        pair(p)
    lobe, diffuse = fitted.colours[:, :1], fitted.colours[:, 1:]
    colours = np.concatenate([HEIGHTS[0] * lobe, HEIGHTS[1] * lobe, diffuse], 1)
    return SlopeFit(lobes, shapes, colours, fitted.cost, fitted.widened)
