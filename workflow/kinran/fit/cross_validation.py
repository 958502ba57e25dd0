"""Folds of lights for cross-validation, and which lights the others surround."""

import numpy as np
from numpy.typing import NDArray

from kinran.base.frames import slopes
from kinran.fit import slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

Array = NDArray[np.float64]


def deal(lights: Array, folds: int) -> NDArray[np.intp]:
    """Deal lights (light, 3) to folds, and return the fold (light,) of each.

    Neighbours go to different folds, so that a light that is left out lies between lights that are not.
    """
    s = slopes(lights)
    left = np.arange(len(s))
    fold, rim = np.zeros(len(s), np.intp), np.linalg.norm(s - s.mean(0), axis=1)
    turn = 0
    while len(left):
        first = left[rim[left].argmax()]
        near = left[np.argsort(np.linalg.norm(s[left] - s[first], axis=1), kind="stable")[:folds]]
        fold[near] = (np.arange(len(near)) + turn) % folds
        left = np.setdiff1d(left, near)
        turn += 1
    return fold


def surrounded(these: Array, others: Array) -> NDArray[np.bool_]:
    """Whether each of these lights (m, 3) is inside the convex hull of the others (n, 3) in (l_x, l_y); (m,)."""
    from scipy.spatial import Delaunay, QhullError

    try:
        return np.asarray(Delaunay(others[:, :2]).find_simplex(these[:, :2]) >= 0)
    except (QhullError, ValueError):  # fewer than three lights, or all on a line
        return np.zeros(len(these), bool)


def left_out(samples: Samples, lobes: Lobes, priors: list[Prior], fold: NDArray[np.intp], threads: int = 1) -> Array:
    """Weighted squared errors (texel, light), summed over channels, under each light by a fit without its fold."""
    error = np.zeros(samples.W.shape)
    for k in range(fold.max() + 1):
        fitted, test = slope.fit(samples.only(fold != k), lobes, priors, threads), fold == k
        left = samples.only(test)
        miss = fitted.predict(left.under) - np.nan_to_num(left.T)
        error[:, test] = left.W * (miss.astype(float) ** 2).sum(1)
    return error
