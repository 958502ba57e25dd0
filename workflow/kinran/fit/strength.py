"""How far the priors of regions are to be trusted: by lights left out."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.folds import deal, surrounded
from kinran.fit.predict import predict

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

STRENGTHS = (1.0, 0.1, 0.0)
"""Shares of a prior's weight that are tried."""
FOLDS = 4
SURE = 2.0
"""Standard errors by which a weaker prior has to be better, over lights."""


def weigh(
    priors: list[slope.Prior],
    T: Samples,
    W: Samples,
    lights: Array,
    region: NDArray[np.intp],
    tail: str = "ggx",
    lobes: int = 1,
    threads: int = 1,
) -> list[slope.Prior]:
    """Each region's prior with as much of its weight as lights left out bear.

    A prior says that a region has one shape and texels differ by little. Where it has several, as where some texels
    see a highlight and others have it between their lights, few samples do not outvote it. So it is kept whole unless
    less of it is surely better, by pairs of lights. Where nothing of it is left, `slope.fit` holds the amplitudes of
    Gaussian lobes instead.

    Parameters
    ----------
    priors : a prior for each region
        Of a sample of texels with T (texel, 3, light), W (texel, light) and region (texel,), as in `slope.fit`.
    """
    if len(lights) >= slope.FEW:
        return priors  # many directions outvote any prior
    errors = [
        _errors([_of(p, share) for p in priors], T, W, lights, region, tail, lobes, threads) for share in STRENGTHS
    ]
    return [_of(p, STRENGTHS[_strongest([e[region == k] for e in errors])]) for k, p in enumerate(priors)]


def _of(prior: slope.Prior, share: float) -> slope.Prior:
    return replace(prior, variance=share * prior.variance)


def _errors(
    priors: list[slope.Prior],
    T: Samples,
    W: Samples,
    lights: Array,
    region: NDArray[np.intp],
    tail: str,
    lobes: int,
    threads: int,
) -> Array:
    """Weighted squared errors (texel, light) of lights left out, of those that the others surround."""
    fold = deal(lights, FOLDS)
    error, counted = np.zeros(W.shape), np.zeros(len(lights), bool)
    for k in range(fold.max() + 1):
        train, test = fold != k, fold == k
        part = np.ascontiguousarray(T[..., train]), np.ascontiguousarray(W[:, train])
        fitted = slope.fit(*part, lights[train], tail, lobes, priors, region, threads)
        miss = predict(fitted, lights[test], tail) - np.nan_to_num(T[..., test])
        error[:, test] = W[:, test] * (miss.astype(float) ** 2).sum(1)
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
