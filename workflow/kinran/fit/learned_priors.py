"""Priors of regions, learned from a sample of their texels."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit, fit, resolution
from kinran.fit.slope_lobes import Lobes

Array = NDArray[np.float64]

SAMPLE = 512
"""Texels of a region that its prior is learned from, by the stage `prior` and in the chart. A choice; no command
compares other numbers."""
HOLD = 10.0
"""Variance, over the mean square of the samples, of a prior that holds shapes at their region's. A choice; no command
compares other values."""
TRUSTED = 12.0
"""Largest variance of a prior, over that of free fits. A choice; no command compares other values."""
POOLED = 0.6
"""Width that a region resolves, over the width that one texel resolves: its facets are turned and so see between the
lights. A choice; no command compares other values."""


def region_priors(fitted: SlopeFit, samples: Samples, regions: int) -> list[Prior]:
    """Priors of regions from fits of a sample of their texels: medians of the shapes, means of the residuals.

    Only texels with fewer samples than the fit has numbers are left out: a region's texels that lost the fewest peaks
    are not typical of it.
    """
    priors = []
    usable = (samples.W > 0).sum(1)
    numbers = int(fitted.numbers)
    for k in range(regions):
        inside = np.flatnonzero((samples.region == k) & (3 * usable > numbers))
        telling = inside if len(inside) else np.arange(len(samples))
        freedom = np.maximum(3.0 * usable[telling] - numbers, 1.0)
        variance = float(np.mean(fitted.cost[telling] / freedom))
        main = int(np.median(_reflected(fitted, telling), 0).argmax())
        priors.append(Prior(np.median(fitted.shapes[telling], 0), max(variance, 1e-12), main))
    return priors


def learn_priors(samples: Samples, regions: int, lobes: Lobes, threads: int = 1) -> list[Prior]:
    """Learn a prior for each region from a sample of its texels.

    Centres come from free fits. Variances come from fits that are held at these centres: the residual of a free fit to
    few samples is too small. Where shapes differ within a region, the residual of held fits is too large; a variance is
    at most `TRUSTED` times that of free fits. Residuals are in proportion to radiance: where samples are left out, as
    saturated peaks are, the variance is raised by the ratio that the held fits predict for all samples.
    """
    samples = samples.unshared()
    T, W = samples.T, samples.W
    finer = POOLED * resolution(samples.under.directions, lobes.count)
    loose = region_priors(fit(samples, lobes, threads=threads, narrow=finer), samples, regions)
    hold = HOLD * float(np.mean(np.square(T, where=W[:, None] > 0, out=np.zeros_like(T)), dtype=float))
    held = fit(samples, lobes, [replace(p, variance=hold) for p in loose], threads)
    tight, whole = region_priors(held, samples, regions), _whole(held, samples, regions)
    lone: list[Prior] | list[None] = [None] * regions
    if (lobes.tail, lobes.count) == ("gaussian", 2) and (W <= 0).any():
        lone = learn_priors(samples, regions, replace(lobes, tail="ggx", count=1), threads)
    return [
        replace(p, variance=min(q.variance, TRUSTED * p.variance) * part, lone=one)
        for p, q, part, one in zip(loose, tight, whole, lone, strict=True)
    ]


def _whole(fitted: SlopeFit, samples: Samples, regions: int) -> list[float]:
    """Mean square of a fit's predictions of all samples over that of the samples in use, by region; at least 1."""
    square, used = np.square(fitted.predict(samples.under), dtype=float).mean(1), samples.W > 0
    inside = [samples.region == k for k in range(regions)]
    seen = [np.mean(square[at], where=used[at]) if used[at].any() else 0 for at in inside]
    return [max(float(square[at].mean() / part), 1.0) if part else 1.0 for at, part in zip(inside, seen, strict=True)]


def _reflected(fitted: SlopeFit, at: NDArray[np.intp]) -> Array:
    """Amplitude times area of each lobe (texel, lobe) of some texels."""
    areas = [np.exp(-p[at, 2] - p[at, 4]) for p in map(fitted.lobe, range(fitted.lobes.count))]
    return fitted.colours[at, :-1].sum(2) * np.stack(areas, 1)
