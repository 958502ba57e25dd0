"""Shrinkage: the weight of each region's prior, chosen by cross-validation over lights."""

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.cross_validation import deal, left_out, surrounded
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

Array = NDArray[np.float64]

STRENGTHS = (1.0, 0.1, 0.0)
"""Shares of a prior's weight that are tried, the largest first. Choices; no command compares others."""
FOLDS = 4
"""Folds of the lights. A choice: the priors are for few lights, of which each fold leaves three quarters."""
SURE = 2.0
"""Standard errors, over lights, by which a weaker prior has to be better. A choice: about one chance in forty."""


def weigh(priors: list[Prior], samples: Samples, lobes: Lobes, threads: int = 1) -> list[Prior]:
    """Give each region's prior the largest share of its weight that no smaller one surely beats on lights left out.

    A prior says that a region has one shape from which its texels differ little. Where a region has several, as where
    some texels see a highlight and others have it between their lights, few samples do not outvote the prior. So it is
    kept whole unless a smaller share is surely better, by pairs of lights. Where no weight is left, `slope.fit` holds
    the amplitudes of Gaussian lobes instead. With `slope.FEW` lights or more, priors are returned as they are.

    Parameters
    ----------
    priors
        A prior for each region.
    samples
        Samples of some texels of every region.
    """
    if samples.under.count >= slope.FEW:
        return priors  # many directions outvote any prior
    errors = [_errors([p.scaled(share) for p in priors], samples.unshared(), lobes, threads) for share in STRENGTHS]
    by_region = [[e[samples.region == k] for e in errors] for k in range(len(priors))]
    return [p.scaled(STRENGTHS[_strongest(e)]) for p, e in zip(priors, by_region, strict=True)]


def _errors(priors: list[Prior], samples: Samples, lobes: Lobes, threads: int) -> Array:
    """Weighted squared errors (texel, light) under lights left out, of those that the others surround."""
    lights = samples.under.directions
    fold = deal(lights, FOLDS)
    error, counted = left_out(samples, lobes, priors, fold, threads), np.zeros(len(lights), bool)
    for k in range(fold.max() + 1):
        counted[fold == k] = surrounded(lights[fold == k], lights[fold != k])
    return error[:, counted] if counted.sum() > len(lights) / 4 else error


def _strongest(errors: list[Array]) -> int:
    """Index of the first prior that none surely beats; errors are (texel, light), for priors of falling weight."""
    if not len(errors[0]):
        return 0
    decibel = [-10 * np.log10(e.mean(0) + 1e-12) for e in errors]
    best = max(decibel, key=np.mean)
    for k, values in enumerate(decibel):
        gain = best - values
        if gain.mean() <= SURE * gain.std() / np.sqrt(max(len(gain) - 1, 1)):
            return k
    return len(decibel) - 1
