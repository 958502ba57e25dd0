"""A fit gone over with saturated samples as what they are: lower bounds, no values."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.predict import predict
from kinran.fit.slope import Prior, SlopeFit

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

ROUNDS = 3


def refit(
    fitted: SlopeFit,
    T: Samples,
    W: Samples,
    bounds: Samples,
    most: float,
    lights: Array,
    tail: str,
    lobes: int,
    priors: list[Prior] | None,
    region: NDArray[np.intp],
    threads: int,
    slopes: Array,
    second: NDArray[np.intp] | None = None,
) -> SlopeFit:
    """Fit texels with saturated samples again, taking what the last fit says above a bound for the sample.

    Parameters
    ----------
    fitted
        Of all texels, as `kinran.fit.slope.fit` gave it; saturated samples had little or no weight.
    bounds : (texel, light) float32
        Weights of saturated samples as bounds; 0 elsewhere.
    most
        Texels of which a larger share of the samples is saturated keep the fit that they have.
    T, W, lights, tail, lobes, priors, region, threads, slopes, second
        As given to `kinran.fit.slope.fit`.
    """
    saturated = bounds > 0
    share = saturated.sum(1) / np.maximum((saturated | (W > 0)).sum(1), 1)
    at = np.flatnonzero((share > 0) & (share <= most))
    if not len(at):
        return fitted
    known, where = T[at], saturated[at][:, None]
    weights = np.where(saturated[at], bounds[at], W[at]).astype(np.float32)
    part = fitted.part(at)
    kind = tail, lobes, priors, region[at], threads
    other = None if second is None else second[at]
    for _ in range(ROUNDS):
        filled = np.where(where, np.maximum(known, predict(part, lights, tail, slopes)), known).astype(np.float32)
        part = slope.fit(filled, weights, lights, *kind, start=part.shapes, slopes=slopes, second=other)
    result = replace(fitted, shapes=fitted.shapes.copy(), colours=fitted.colours.copy(), cost=fitted.cost.copy())
    result.put(at, part)
    return result
