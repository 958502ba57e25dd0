"""What the samples of a texel see of the peaks of its lobes, compiled."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.lobes import LOBE_SIZE

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@njit(cache=True, nogil=True, error_model="numpy")
def peaks(
    shapes: Array,
    heights: Array,
    s: Array,
    T: Single,
    W: Single,
    lit: Single,
    brightest: Array,
    least: Array,
    distance: Array,
) -> None:
    """Find the brightest sample of each texel, and how near lights come to the peaks of lobes that are higher.

    Parameters
    ----------
    shapes, heights : (texel, K), (texel, lobe)
        Shapes of the lobes, and their amplitudes in the channel that has the most.
    s : (light, 2)
        Half-vector slopes of the lights.
    T, W : (texel, 3, light), (texel, light)
        Samples and their weights.
    lit : (texel, light)
        Over 0 where a light can see a peak.
    brightest : (texel,)
        Result: the brightest sample that has weight.
    least, distance : (texel, lobe)
        Results: the least q of a light that can see a peak, and the least squared distance of its slopes from the
        peak; untouched where the brightest sample is higher.
    """
    for t in range(len(T)):
        most = 0.0
        for c in range(3):
            for i in range(len(s)):
                if W[t, i] > 0.0 and T[t, c, i] > most:
                    most = T[t, c, i]
        brightest[t] = most
        for k in range(heights.shape[1]):
            if heights[t, k] <= most:
                continue
            p = shapes[t, LOBE_SIZE * k : LOBE_SIZE * (k + 1)]
            ea, ec = math.exp(p[2]), math.exp(p[4])
            least[t, k] = distance[t, k] = np.inf
            for i in range(len(s)):
                if lit[t, i] > 0.0:
                    dx, dy = s[i, 0] - p[0], s[i, 1] - p[1]
                    u, v = ea * dx + p[3] * dy, ec * dy
                    least[t, k] = min(least[t, k], u * u + v * v)
                    distance[t, k] = min(distance[t, k], dx * dx + dy * dy)
