"""A fit gone over with saturated samples as what they are: lower bounds, no values.

Where many samples of a texel are saturated, its peak is lost, and two Gaussian lobes are more than the flanks can tell:
they are made of one GGX lobe under its region's prior.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.lobes import LOBE_SIZE
from kinran.fit.predict import predict
from kinran.fit.slope import Prior, SlopeFit
from kinran.fit.start import HEIGHTS, pair

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

ROUNDS = 3
LOST = (0.05, 0.5)
"""Shares of saturated samples between which one lobe is better than two. Of more, no lobe is found."""


def refit(
    fitted: SlopeFit,
    T: Samples,
    W: Samples,
    bounds: Samples,
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
    T, W, lights, tail, lobes, priors, region, threads, slopes, second
        As given to `kinran.fit.slope.fit`.
    """
    saturated = bounds > 0
    share = saturated.sum(1) / np.maximum((saturated | (W > 0)).sum(1), 1)
    lone = [prior.lone for prior in priors or () if prior.lone]
    lost = (share > LOST[0]) & (share <= LOST[1]) & bool(lone)
    result = replace(fitted, shapes=fitted.shapes.copy(), colours=fitted.colours.copy(), cost=fitted.cost.copy())
    for at, kind in (
        (np.flatnonzero((share > 0) & ~lost), (tail, lobes, priors)),
        (np.flatnonzero(lost), ("ggx", 1, lone)),
    ):
        if not len(at):
            continue
        given, of_one = (*kind, region[at], threads), kind[2] is lone
        known, where = T[at], saturated[at][:, None]
        weights = np.where(saturated[at], bounds[at], W[at]).astype(np.float32)
        part = slope.fit(known, W[at], lights, *given, slopes=slopes) if of_one else fitted.part(at)
        other = None if second is None or of_one else second[at]
        for _ in range(ROUNDS):
            filled = np.where(where, np.maximum(known, predict(part, lights, kind[0], slopes)), known)
            start = part.shapes
            part = slope.fit(
                filled.astype(np.float32), weights, lights, *given, start=start, slopes=slopes, second=other
            )
        result.put(at, as_pair(part) if of_one else part)
    return result


def as_pair(fitted: SlopeFit) -> SlopeFit:
    """Two Gaussian lobes of each one of GGX."""
    shapes = np.concatenate([fitted.shapes[:, :LOBE_SIZE], fitted.shapes], 1)
    for p in shapes:
        pair(p)
    lobe, diffuse = fitted.colours[:, :1], fitted.colours[:, 1:]
    return SlopeFit(shapes, np.concatenate([HEIGHTS[0] * lobe, HEIGHTS[1] * lobe, diffuse], 1), fitted.cost)
