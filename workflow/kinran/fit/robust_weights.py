"""Robust weights, by Huber's loss: samples far from the last fit count by their distance, not by its square.

`kinran.fit.trust` decides where they are better than least squares: on clean samples they cost 2 to 15 % in error.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.fit import slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes

Single = NDArray[np.float32]

ROUNDS = 6
"""Rounds of reweighting. A choice."""
HUBER_FLOOR, HUBER_SHARE = 0.02, 0.05
"""Shares of the texel's level and of the model's value up to which a residual counts by its square: about what lobes
leave of clean samples. A choice; `kinran bench stability` measures its gain and cost."""


def robust(
    samples: Samples, lobes: Lobes, priors: list[Prior] | None = None, threads: int = 1
) -> tuple[SlopeFit, Samples]:
    """Fit with Huber's loss, and return the fit and the samples with their robust weights.

    A residual over 0.02 of the texel's level + 0.05 of the model's value counts by its size, not by its square.
    Parameters are those of `kinran.fit.slope.fit`.
    """
    T, W = samples.T, samples.W
    level = np.sqrt(np.mean(np.square(T), (1, 2), where=samples.usable()))[:, None]
    # the median over lights, as large as a lobe leaves it, is what the first start can trust
    fitted, damped = slope.fit(replace(samples, T=_without_spikes(samples)), lobes, priors, threads), samples
    for _ in range(ROUNDS):
        model = fitted.predict(samples.under)
        scale = HUBER_FLOOR * level + HUBER_SHARE * np.linalg.norm(model, axis=1)
        far = np.linalg.norm(np.nan_to_num(T) - model, axis=1) / np.maximum(scale, 1e-30)
        damped = replace(samples, W=(W / np.maximum(far, 1)).astype(np.float32))
        fitted = slope.fit(damped, lobes, priors, threads, start=fitted.shapes)
    return fitted, damped


def _without_spikes(samples: Samples) -> Single:
    """Samples (texel, 3, light) cut at the second largest of their three nearest lights, for a robust start."""
    s = frames.slopes(samples.under.directions)
    near = frames.nearest(s, 4)[1][:, 1:]
    if near.shape[1] < 2:
        return samples.T
    around = np.sort(samples.T[:, :, near], axis=3)[..., -2]
    return np.minimum(samples.T, around)
