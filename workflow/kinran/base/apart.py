"""Directions that lie apart."""

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames

Array = NDArray[np.float64]


def spread(lights: Array, count: int, taken: Array | None = None) -> NDArray[np.intp]:
    """Indices (count,) of lights that lie apart in the plane of half-vector slopes, each the farthest from all before.

    Parameters
    ----------
    lights : (n, 3)
        Directions to choose from.
    count
        Number of directions to choose; all of them if there are not more.
    taken : (m, 3)
        Directions that are there already. Without them the first is the one nearest to the normal.
    """
    s = frames.slopes(lights)
    chosen: list[int] = []
    distance = np.full(len(s), np.inf)
    for t in [] if taken is None else frames.slopes(taken):
        distance = np.minimum(distance, np.linalg.norm(s - t, axis=1))
    while len(chosen) < min(count, len(s)):
        started = bool(chosen) or taken is not None
        chosen.append(int(distance.argmax() if started else np.linalg.norm(s, axis=1).argmin()))
        distance = np.minimum(distance, np.linalg.norm(s - s[chosen[-1]], axis=1))
    return np.array(chosen, np.intp)
