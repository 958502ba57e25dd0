"""Fits whose samples are judged by an earlier fit: censored where they are saturated, damped where they are far off.

Neither is the pipeline's default. Censoring gains where at most some 3 % of a texel's samples are saturated, and
loses to leaving them out where more are. Huber's loss costs 5 to 8 % in error where nothing is wrong.

What is solved for is the business of `fit`: `kinran.fit.slope.fit`, or a partial of it with lobes, priors, threads.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinran import frames
from kinran.fit import slope
from kinran.fit.predict import predict
from kinran.fit.slope import SlopeFit

Array = NDArray[np.float64]
Samples = NDArray[np.float32]
Fit = Callable[..., SlopeFit]

ROUNDS = 6
CENSORED_SHARE = 0.03
HUBER_FLOOR, HUBER_SHARE = 0.02, 0.05


def censored(
    T: Samples, W: Samples, saturated: NDArray[np.bool_], lights: Array, tail: str = "ggx", fit: Fit = slope.fit
) -> SlopeFit:
    """Fit with saturated samples as lower bounds: what the model says above them is taken for the sample.

    Texels of which more than 3 % are saturated, leave these out.

    Parameters
    ----------
    T, W, lights, tail
        As of `kinran.fit.slope.fit`.
    saturated : (texel, light) bool
        Samples that are only known to be as large as this.
    fit
        Called as ``fit(T, W, lights, tail)`` and, the later times, with the shapes to start from as ``start``.
    """
    share = (saturated & (W > 0)).sum(1) / np.maximum((W > 0).sum(1), 1)
    bounds = saturated & (share <= CENSORED_SHARE)[:, None]
    weights = np.where(saturated & ~bounds, 0, W).astype(np.float32)
    fitted = fit(T, np.where(saturated, 0, W).astype(np.float32), lights, tail)
    for _ in range(ROUNDS):
        filled = np.where(bounds[:, None], np.maximum(T, predict(fitted, lights, tail)), T)
        fitted = fit(filled, weights, lights, tail, start=fitted.shapes)
    return fitted


def robust(T: Samples, W: Samples, lights: Array, tail: str = "ggx", fit: Fit = slope.fit) -> SlopeFit:
    """Fit with Huber's loss, for sets with outliers; parameters as of `censored`.

    A residual over (0.02 of the texel's level + 0.05 of the model) counts by its size, not by its square.
    """
    level = np.sqrt(np.mean(np.square(T), (1, 2), where=(W > 0)[:, None] & np.isfinite(T)))[:, None]
    # the median over lights, as large as a lobe leaves it, is what the first start can trust
    fitted = fit(_without_spikes(T, lights), W, lights, tail)
    for _ in range(ROUNDS):
        model = predict(fitted, lights, tail)
        scale = HUBER_FLOOR * level + HUBER_SHARE * np.linalg.norm(model, axis=1)
        far = np.linalg.norm(np.nan_to_num(T) - model, axis=1) / np.maximum(scale, 1e-30)
        fitted = fit(T, (W / np.maximum(far, 1)).astype(np.float32), lights, tail, start=fitted.shapes)
    return fitted


def _without_spikes(T: Samples, lights: Array) -> Samples:
    """Samples cut at the second largest of their three nearest lights, so that the start is robust, too."""
    near = cKDTree(frames.slopes(lights)).query(frames.slopes(lights), min(4, len(lights)))[1][:, 1:]
    if near.shape[1] < 2:
        return T
    around = np.sort(T[:, :, near], axis=3)[..., -2]
    return np.minimum(T, around)
