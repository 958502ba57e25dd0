"""The pipeline's fit of the slope model to samples in memory: what is learned of regions and lights, then the lobes."""

from kinran.fit import bounded, learned_priors, robust_weights, shrinkage, slope, trust, unseen_peaks
from kinran.fit.region_priors import Priors
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes


def learn(samples: Samples, regions: int, lobes: Lobes, threads: int = 1) -> Priors:
    """Learn the priors of regions, the weights of lights and whether to fit robustly, from a sample of their texels."""
    samples = samples.unshared()
    factors, outliers = trust.learn(samples, lobes, threads)
    samples = samples.weighed(factors)
    if outliers:
        _, samples = robust_weights.robust(samples, lobes, threads=threads)
    priors = learned_priors.learn_priors(samples, regions, lobes, threads)
    return Priors(shrinkage.weigh(priors, samples, lobes, threads), factors, outliers)


def fit(samples: Samples, lobes: Lobes, priors: Priors | None = None, threads: int = 1) -> SlopeFit:
    """Fit lobes by least squares or with robust weights, then saturated samples as bounds, then needles between lights.

    Weights of lights are taken as they are in the samples (`Samples.weighed`).
    """
    regions = priors.regions if priors else None
    if priors and priors.outliers:
        found, samples = robust_weights.robust(samples, lobes, regions, threads)
    else:
        found = slope.fit(samples, lobes, regions, threads)
    found = bounded.refit(found, samples, regions, threads)
    return unseen_peaks.refit(found, samples, regions, threads)
