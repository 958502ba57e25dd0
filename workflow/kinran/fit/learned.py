"""Priors of regions, learned from a sample of their texels."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit.lobes import LOBE_SIZE
from kinran.fit.predict import predict
from kinran.fit.slope import Prior, SlopeFit, fit, resolution

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

HOLD = 10.0
"""Variance, over the mean square of the samples, whose prior holds the shapes at their region's."""
TRUSTED = 12.0
POOLED = 0.6
"""Share of the resolution of one texel that a region resolves: its facets are turned to see between the lights."""


def region_priors(fitted: SlopeFit, W: Samples, region: NDArray[np.intp], regions: int) -> list[Prior]:
    """Priors of regions from free fits of a sample of their texels: medians of shape, means of residual.

    Only texels with fewer samples than numbers have no say: those that lost the fewest peaks are not typical.
    """
    priors = []
    usable = (W > 0).sum(1)
    numbers = fitted.shapes.shape[1] + 3 * fitted.colours.shape[1]
    for k in range(regions):
        inside = np.flatnonzero((region == k) & (3 * usable > numbers))
        telling = inside if len(inside) else np.arange(len(region))
        freedom = np.maximum(3.0 * usable[telling] - numbers, 1.0)
        variance = float(np.mean(fitted.cost[telling] / freedom))
        main = int(np.median(_reflected(fitted, telling), 0).argmax())
        priors.append(Prior(np.median(fitted.shapes[telling], 0), max(variance, 1e-12), main))
    return priors


def learn_priors(
    T: Samples,
    W: Samples,
    lights: Array,
    region: NDArray[np.intp],
    regions: int,
    tail: str = "ggx",
    lobes: int = 1,
    threads: int = 1,
    bent: bool = True,
) -> list[Prior]:
    """Priors of regions from a sample of their texels; parameters as in `fit`.

    Centres come from free fits, variances from fits that are held at these centres: a free fit to few samples
    leaves too little of them. Where shapes differ within the region, held fits leave too much; `TRUSTED` times what
    free fits leave is the most. What is left is in proportion to what is seen: where samples are left out, as
    saturated peaks are, it is made as large as the held fits say that all of them are.
    """
    finer = POOLED * resolution(lights, lobes)
    free = fit(T, W, lights, tail, lobes, threads=threads, bent=bent, narrow=finer)
    loose = region_priors(free, W, region, regions)
    hold = HOLD * float(np.mean(np.square(T, where=W[:, None] > 0, out=np.zeros_like(T)), dtype=float))
    given = [replace(p, variance=hold) for p in loose]
    fitted = fit(T, W, lights, tail, lobes, given, region, threads, bent)
    tight, whole = region_priors(fitted, W, region, regions), _whole(fitted, W, lights, tail, region, regions)
    lone: list[Prior] | list[None] = [None] * regions
    if (tail, lobes) == ("gaussian", 2) and (W <= 0).any():
        lone = learn_priors(T, W, lights, region, regions, "ggx", 1, threads, bent)
    return [
        replace(p, variance=min(held.variance, TRUSTED * p.variance) * part, lone=one)
        for p, held, part, one in zip(loose, tight, whole, lone, strict=True)
    ]


def _whole(
    fitted: SlopeFit, W: Samples, lights: Array, tail: str, region: NDArray[np.intp], regions: int
) -> list[float]:
    """Mean square of all samples over that of those in use, by a fit, of each region: 1 where all are in use."""
    square, used = np.square(predict(fitted, lights, tail), dtype=float).mean(1), W > 0
    inside = [region == k for k in range(regions)]
    seen = [np.mean(square[at], where=used[at]) if used[at].any() else 0 for at in inside]
    return [max(float(square[at].mean() / part), 1.0) if part else 1.0 for at, part in zip(inside, seen, strict=True)]


def _reflected(fitted: SlopeFit, at: NDArray[np.intp]) -> Array:
    """Amplitude times area of each lobe (texel, lobe) of some texels."""
    lobes = [fitted.shapes[at, LOBE_SIZE * k : LOBE_SIZE * (k + 1)] for k in range(fitted.colours.shape[1] - 1)]
    return fitted.colours[at, :-1].sum(2) * np.stack([np.exp(-p[:, 2] - p[:, 4]) for p in lobes], 1)
