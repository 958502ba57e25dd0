"""Refit lobes whose peaks no light sees: needles between lights, which a path tracer shows as sparks.

Where the distance of lights is uneven, as between two rings of a dome, a width that they resolve on average is a needle
in the gap. What the samples say of such a lobe is its value at the light that sees the most of it, and its amplitude is
extrapolated from there by a factor that grows as e^q. Here that factor has a bound, `RISE`, at each lobe's own place.
"""

import math

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver import prepare
from kinran.fit.solver.peaks import peaks

Array = NDArray[np.float64]

RISE = 4.0
"""Largest peak of a lobe, over what the light that sees the most of it has of it. A square grid of lights allows two
Gaussian lobes just this in the middle of four lights: they are no narrower than 0.6 of its side (`slope.NEEDLE`), and
e^(0.5 / 0.6²) is 4.0."""
ROUNDING = 1e-5
"""Share of a bound by which single precision may be over it."""
ROUNDS = 3
"""Fits in which the smallest width is that of the gap where the last fit has its peak. A choice: what still exceeds the
bound then is lowered to it."""


def refit(fitted: SlopeFit, samples: Samples, priors: list[Prior] | None = None, threads: int = 1) -> SlopeFit:
    """Fit texels again whose peaks exceed both their samples and `RISE` times what a light sees of them.

    Lobes may then be no narrower than the gap of the lights at their peak. What exceeds the bound after `ROUNDS` such
    fits has its amplitude lowered to it. So no lobe is over `RISE` times its largest value at a light, nor over `RISE`
    times the brightest sample of its texel, unless a sample is saturated: then nobody knows the brightest.

    Parameters
    ----------
    fitted
        Fit of all texels.
    samples
        Samples of the same texels.
    priors
        A prior for each region.
    """
    prepare()
    result, narrow = fitted.copy(), np.zeros(len(samples))
    at, factor, gap = _exceeding(result, samples, np.arange(len(samples)))
    for _ in range(ROUNDS):
        if not len(at):
            return result
        narrow[at] = np.minimum(np.maximum(narrow[at], gap), slope.MAX_WIDTH / 2)
        some = samples.of(at)
        result.put(at, slope.fit(some, fitted.lobes, priors, threads, start=result.shapes[at], gaps=narrow[at]))
        result.widened[at] = True
        at, factor, gap = _exceeding(result, samples, at)
    result.colours[at, : fitted.lobes.count] *= factor[..., None]
    return result


def _exceeding(fitted: SlopeFit, samples: Samples, among: NDArray[np.intp]) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the texels of some that exceed the bound, the factors (texel, lobe) to it, and the gaps (texel,)."""
    some = samples if len(among) == len(samples) else samples.of(among)
    lobes = fitted.lobes
    heights = fitted.colours[among, : lobes.count].max(-1)
    # a saturated sample sees a peak as well as another
    lit = some.W if some.bounds is None else np.maximum(some.W, some.bounds)
    brightest, least, distance = np.zeros(len(some)), np.zeros_like(heights), np.zeros_like(heights)
    for cell, at in some.under.cells():
        part = tuple(np.ascontiguousarray(a[at]) for a in (fitted.shapes[among], heights))
        given = tuple(np.ascontiguousarray(a[at]) for a in (some.T, some.W, lit))
        found = tuple(np.ascontiguousarray(a[at]) for a in (brightest, least, distance))
        peaks(*part, some.under.slopes[cell], *given, *found)
        brightest[at], least[at], distance[at] = found
    seen = np.exp(-least) if lobes.tail == "gaussian" else 1 / (1 + least) ** 2
    allowed = np.maximum(RISE * seen * heights, brightest[:, None])
    known = np.ones(len(some), bool) if some.bounds is None else some.bounds.max(1) <= 0
    allowed[known] = np.minimum(allowed, RISE * brightest[:, None])[known]
    unseen = heights > allowed * (1 + ROUNDING)
    exceeding = np.flatnonzero(unseen.any(1))
    factor = np.where(unseen, allowed / np.maximum(heights, 1e-30), 1)
    gap = np.where(unseen, np.sqrt(distance / _fallen(lobes)), 0).max(1, initial=0)
    return among[exceeding], factor[exceeding], gap[exceeding]


def _fallen(lobes: Lobes) -> float:
    """Return q at which a lobe has fallen to 1 / `RISE` of its peak."""
    return math.log(RISE) if lobes.tail == "gaussian" else math.sqrt(RISE) - 1
