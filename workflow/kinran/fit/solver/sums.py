"""Lobes and the diffuse term summed at lights, compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE, diffuse, lobe

Array = NDArray[np.float64]


@njit(cache=True, nogil=True, error_model="numpy")
def summed(tail: int, shapes: Array, colours: Array, s: Array, lights: Array, out: NDArray[np.float32]) -> None:
    """Lobes and the diffuse term, whose columns `colours` (texel, column, 3) are in this order."""
    lobes = colours.shape[1] - 1
    unused = np.empty(LOBE_SIZE + DIFFUSE_SIZE)
    for t in range(len(shapes)):
        for i in range(len(lights)):
            value = diffuse(shapes[t, LOBE_SIZE * lobes :], lights[i, 0], lights[i, 1], lights[i, 2], unused)
            x, y, z = value * colours[t, lobes, 0], value * colours[t, lobes, 1], value * colours[t, lobes, 2]
            for k in range(lobes):
                value = lobe(tail, shapes[t, LOBE_SIZE * k : LOBE_SIZE * (k + 1)], s[i, 0], s[i, 1], unused)
                x, y, z = x + value * colours[t, k, 0], y + value * colours[t, k, 1], z + value * colours[t, k, 2]
            out[t, 0, i], out[t, 1, i], out[t, 2, i] = x, y, z
