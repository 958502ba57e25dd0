"""Huber's loss: samples far from an earlier fit count by how far they are off, not by its square.

What is solved for is the business of `fit`: `kinran.fit.slope.fit`, or a partial of it with lobes, priors, threads.
`kinran.fit.trust` says where it is better than least squares: on clean samples it costs 2 to 15 % in error.
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


def robust(
    T: Samples, W: Samples, lights: Array, tail: str = "ggx", fit: Fit = slope.fit, slopes: Array | None = None
) -> tuple[SlopeFit, Samples]:
    """Fit with Huber's loss, and the weights (texel, light) that it comes to.

    A residual over (0.02 of the texel's level + 0.05 of the model) counts by its size, not by its square.

    Parameters
    ----------
    T, W, lights, tail, slopes
        As of `kinran.fit.slope.fit`.
    fit
        Called as ``fit(T, W, lights, tail)`` and, the later times, with the shapes to start from as ``start``.
    """
    level = np.sqrt(np.mean(np.square(T), (1, 2), where=(W > 0)[:, None] & np.isfinite(T)))[:, None]
    # the median over lights, as large as a lobe leaves it, is what the first start can trust
    fitted, damped = fit(_without_spikes(T, lights), W, lights, tail), W
    for _ in range(ROUNDS):
        model = predict(fitted, lights, tail, slopes)
        scale = HUBER_FLOOR * level + HUBER_SHARE * np.linalg.norm(model, axis=1)
        far = np.linalg.norm(np.nan_to_num(T) - model, axis=1) / np.maximum(scale, 1e-30)
        damped = (W / np.maximum(far, 1)).astype(np.float32)
        fitted = fit(T, damped, lights, tail, start=fitted.shapes)
    return fitted, damped


def _without_spikes(T: Samples, lights: Array) -> Samples:
    """Samples cut at the second largest of their three nearest lights, so that the start is robust, too."""
    near = cKDTree(frames.slopes(lights)).query(frames.slopes(lights), min(4, len(lights)))[1][:, 1:]
    if near.shape[1] < 2:
        return T
    around = np.sort(T[:, :, near], axis=3)[..., -2]
    return np.minimum(T, around)
