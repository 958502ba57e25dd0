"""How far the priors of regions are to be trusted: by lights left out."""

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.cross_validation import deal, surrounded
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

Array = NDArray[np.float64]

STRENGTHS = (1.0, 0.1, 0.0)
"""Shares of a prior's weight that are tried."""
FOLDS = 4
"""Folds of the lights. A choice: the priors are for few lights, of which each fold leaves three quarters."""
SURE = 2.0
"""Standard errors by which a weaker prior has to be better, over lights."""


def weigh(priors: list[Prior], samples: Samples, lobes: Lobes, threads: int = 1) -> list[Prior]:
    """Each region's prior with as much of its weight as lights left out bear.

    A prior says that a region has one shape and texels differ by little. Where it has several, as where some texels
    see a highlight and others have it between their lights, few samples do not outvote it. So it is kept whole unless
    less of it is surely better, by pairs of lights. Where nothing of it is left, `slope.fit` holds the amplitudes of
    Gaussian lobes instead.

    Parameters
    ----------
    priors
        A prior for each region, of a sample of its texels.
    """
    if samples.under.count >= slope.FEW:
        return priors  # many directions outvote any prior
    errors = [_errors([p.scaled(share) for p in priors], samples.unshared(), lobes, threads) for share in STRENGTHS]
    by_region = [[e[samples.region == k] for e in errors] for k in range(len(priors))]
    return [p.scaled(STRENGTHS[_strongest(e)]) for p, e in zip(priors, by_region, strict=True)]


def _errors(priors: list[Prior], samples: Samples, lobes: Lobes, threads: int) -> Array:
    """Weighted squared errors (texel, light) of lights left out, of those that the others surround."""
    lights = samples.under.directions
    fold = deal(lights, FOLDS)
    error, counted = np.zeros(samples.W.shape), np.zeros(len(lights), bool)
    for k in range(fold.max() + 1):
        train, test = fold != k, fold == k
        fitted = slope.fit(samples.only(train), lobes, priors, threads)
        left = samples.only(test)
        miss = fitted.predict(left.under) - np.nan_to_num(left.T)
        error[:, test] = left.W * (miss.astype(float) ** 2).sum(1)
        counted[test] = surrounded(lights[test], lights[train])
    return error[:, counted] if counted.sum() > len(lights) / 4 else error


def _strongest(errors: list[Array]) -> int:
    """Index of the first, of errors (texel, light) by falling strength, than which none is surely better."""
    if not len(errors[0]):
        return 0
    decibel = [-10 * np.log10(e.mean(0) + 1e-12) for e in errors]
    best = max(decibel, key=np.mean)
    for k, values in enumerate(decibel):
        gain = best - values
        if gain.mean() <= SURE * gain.std() / np.sqrt(max(len(gain) - 1, 1)):
            return k
    return len(decibel) - 1
