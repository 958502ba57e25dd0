"""Lobes in slope space, fitted to a trial as the pipeline fits them to a stack."""

from dataclasses import replace

import numpy as np

from kinran.fit import bounded, learned_priors, slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples, spread_over_regions
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes


def fit(samples: Samples, lobes: Lobes) -> SlopeFit:
    """Fit every texel under its region's prior, with saturated samples as bounds."""
    samples = of_present_regions(samples)
    known = priors(samples, lobes)
    return bounded.refit(slope.fit(samples, lobes, known), samples, known)


def priors(samples: Samples, lobes: Lobes) -> list[Prior]:
    """Learn priors from as many texels of each region as the pipeline takes; every region has texels."""
    regions = int(samples.region.max()) + 1
    some = np.flatnonzero(spread_over_regions(samples.region, regions, learned_priors.SAMPLE))
    return learned_priors.learn_priors(samples.of(some), regions, lobes)


def of_present_regions(samples: Samples) -> Samples:
    """Number the regions anew without those that have no texel here; these then share no texel either."""
    present, region = np.unique(samples.region, return_inverse=True)
    shared = np.isin(samples.second, present)
    second = np.where(shared, np.searchsorted(present, samples.second), region)
    return replace(samples, region=region, second=second)
