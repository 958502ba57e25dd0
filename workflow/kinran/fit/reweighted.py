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
HUBER_FLOOR, HUBER_SHARE = 0.02, 0.05


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
