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
    T, W, lights, tail, lobes, priors, region, threads, slopes
        As given to `kinran.fit.slope.fit`.
    """
    saturated = bounds > 0
    share = saturated.sum(1) / np.maximum((saturated | (W > 0)).sum(1), 1)
    at = np.flatnonzero((share > 0) & (share <= most))
    if not len(at):
        return fitted
    known, where = T[at], saturated[at][:, None]
    weights = np.where(saturated[at], bounds[at], W[at]).astype(np.float32)
    part = SlopeFit(fitted.shapes[at], fitted.colours[at], fitted.cost[at])
    for _ in range(ROUNDS):
        filled = np.where(where, np.maximum(known, predict(part, lights, tail, slopes)), known).astype(np.float32)
        part = slope.fit(
            filled, weights, lights, tail, lobes, priors, region[at], threads, start=part.shapes, slopes=slopes
        )
    result = replace(fitted, shapes=fitted.shapes.copy(), colours=fitted.colours.copy(), cost=fitted.cost.copy())
    for name in ("shapes", "colours", "cost"):
        getattr(result, name)[at] = getattr(part, name)
    return result
