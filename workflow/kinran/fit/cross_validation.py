"""Lights left out in turn, and which of them the others surround."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from kinran.base.frames import slopes

Array = NDArray[np.float64]


def deal(lights: Array, folds: int) -> NDArray[np.intp]:
    """Fold of each light: neighbours go to different ones, so that what is left out lies between what is not."""
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
    """Whether each of these lights (m, 3) is inside the hull of the others, in (l_x, l_y)."""
    try:
        return np.asarray(Delaunay(others[:, :2]).find_simplex(these[:, :2]) >= 0)
    except (QhullError, ValueError):  # fewer than three lights, or all on a line
        return np.zeros(len(these), bool)
