"""Lobes in slope space, fitted to a trial as the pipeline fits them to a stack."""

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran.chart.trial import Trial
from kinran.fit import bounded, learned, slope

PRIOR_SAMPLE = 512
"""Texels of a region that its prior is made of."""


def priors(trial: Trial, tail: str, lobes: int, bent: bool = True) -> tuple[list[slope.Prior], NDArray[np.intp]]:
    """Priors of the regions that the trial has texels of, and the index (texel,) of each texel's prior."""
    present, region = np.unique(trial.region, return_inverse=True)
    some = _sample(region)
    T, W = trial.T[some], trial.W[some]
    found = learned.learn_priors(T, W, trial.lights, region[some], len(present), tail=tail, lobes=lobes, bent=bent)
    return found, region


def fit(trial: Trial, tail: str, lobes: int, with_prior: bool = True) -> slope.SlopeFit:
    """Fit every texel, under its region's prior or alone."""
    if not with_prior:
        return slope.fit(trial.T, trial.W, trial.lights, tail, lobes)
    known, region = priors(trial, tail, lobes)
    present = np.unique(trial.region)
    second = np.where(np.isin(trial.second, present), np.searchsorted(present, trial.second), region)
    kind = tail, lobes, known, region
    fitted = slope.fit(trial.T, trial.W, trial.lights, *kind, second=second)
    half = frames.slopes(trial.lights)
    return bounded.refit(fitted, trial.T, trial.W, trial.bounds, trial.lights, *kind, 1, half, second)


def numbers(fitted: slope.SlopeFit) -> int:
    """Numbers of a texel."""
    return int(fitted.shapes.shape[1] + 3 * fitted.colours.shape[1])


def _sample(region: NDArray[np.intp]) -> NDArray[np.intp]:
    """At most 512 texels of each region, evenly through the map."""
    parts = []
    for k in np.unique(region):
        inside = np.flatnonzero(region == k)
        parts.append(inside[np.linspace(0, len(inside) - 1, min(PRIOR_SAMPLE, len(inside))).astype(int)])
    return np.sort(np.concatenate(parts))
