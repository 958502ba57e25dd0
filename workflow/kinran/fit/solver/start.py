"""Where the search for a lobe starts: moments, in slope space, of what stands above the diffuse floor."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.lobes import GAUSSIAN, LOBE_SIZE

Array = NDArray[np.float64]
Single = NDArray[np.float32]
f4 = np.float32

THRESHOLD = f4(0.4)
"""Share of the level under which a sample is not of the highlight: a quarter of the peak."""
NARROWER, WIDER = math.sqrt(2.0), math.sqrt(0.384)
"""Factors of the widths' inverses that make two Gaussians of a GGX lobe (to 3 %)."""
HEIGHTS = 0.76, 0.21
"""Of these Gaussians."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def floor_of(y: Single, L: Single, root: Single) -> f4:
    """Diffuse floor k of y ≈ k cos θ_i + highlights: the mean of what lies under the mean, twice."""
    k = f4(3e38)
    for _ in range(3):
        top, bottom = f4(0.0), f4(0.0)
        for i in range(y.size):
            cosine = L[2, i] * root[i]
            under = cosine if y[i] <= k * L[2, i] else f4(0.0)
            top += under * root[i] * y[i]
            bottom += under * cosine
        k = max(top / max(bottom, f4(1e-30)), f4(0.0))
    return k


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def level_of(y: Single, L: Single, floor: f4) -> f4:
    """Level Σ r³ / Σ r² of what stands above the floor: 2/3 of the peak of a Gaussian lobe, 3/5 of one of GGX."""
    top, bottom = f4(0.0), f4(0.0)
    for i in range(y.size):
        r = max(y[i] - floor * L[2, i], f4(0.0))
        bottom += r * r
        top += r * r * r
    return top / max(bottom, f4(1e-30))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def highlight(
    tail: int, y: Single, S: Single, L: Single, solid: Single, root: Single, Y: Single, p: Array, tint: Array
) -> None:
    """Shape `p` (5, of the first lobe) and colour `tint` (3,) of the highlight.

    Parameters
    ----------
    y : (light,)
        Mean of the channels; 0 where a sample is not used.
    S, L, solid : (2, light), (3, light), (light,)
        Half-vector slopes, directions, and the solid angle that a light stands for.
    root : (light,)
        Roots of the weights; 0 where a sample is not used.
    Y : (3, light)
        Channels, weighted by `root`.
    """
    floor = f4(floor_of(y, L, root))
    threshold = THRESHOLD * f4(level_of(y, L, floor))
    total = x = z = xx = xz = zz = c0 = c1 = c2 = f4(0.0)
    for i in range(y.size):
        above = max(y[i] - floor * L[2, i] - threshold, f4(0.0))
        c0, c1, c2 = c0 + above * Y[0, i], c1 + above * Y[1, i], c2 + above * Y[2, i]
        q = above * solid[i]
        qx, qz = q * S[0, i], q * S[1, i]
        total, x, z = total + q, x + qx, z + qz
        xx, xz, zz = xx + qx * S[0, i], xz + qx * S[1, i], zz + qz * S[1, i]
    tint[0], tint[1], tint[2] = c0, c1, c2
    s = float(total) + 1e-30
    mx, my = float(x) / s, float(z) / s
    inflate = 1.6  # the threshold cut the tails off
    vxx = min(max(inflate * (float(xx) / s - mx * mx), 5e-4), 0.3)
    vyy = min(max(inflate * (float(zz) / s - my * my), 5e-4), 0.3)
    limit = 0.95 * math.sqrt(vxx * vyy)
    vxy = min(max(inflate * (float(xz) / s - mx * my), -limit), limit)
    scale = (2.0 if tail == GAUSSIAN else 2.5) * (vxx * vyy - vxy * vxy)
    a, b, d = vyy / scale, -vxy / scale, vxx / scale
    p[0], p[1] = mx, my
    p[2] = 0.5 * math.log(a)
    p[3] = b / math.sqrt(a)
    p[4] = 0.5 * math.log(max(d - p[3] * p[3], 1e-3))


@njit(cache=True, nogil=True, error_model="numpy")
def pair(p: Array) -> None:
    """Two Gaussian lobes of the one of GGX that stands first, the narrower one before the other."""
    for k in range(LOBE_SIZE):
        p[LOBE_SIZE + k] = p[k]
    for at, factor in ((0, NARROWER), (LOBE_SIZE, WIDER)):
        p[at + 2] += math.log(factor)
        p[at + 3] *= factor
        p[at + 4] += math.log(factor)
