"""One texel's lobes and their derivatives, compiled for the solver.

The definitions are those of `kinran_bsdf.models`, against which the tests hold them. A lobe in slope space has
five shape parameters (μ_x, μ_y, α, β, γ), the Cholesky form of its inverse squared-width matrix:
u = e^α d_x + β d_y, v = e^γ d_y, q = u² + v², with d = s - μ and s the half-vector slopes. The diffuse term has
two, the slopes of its normal.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

LOBE_SIZE = 5
"""Shape parameters of a lobe."""
DIFFUSE_SIZE = 2
"""Shape parameters of the diffuse term."""
GAUSSIAN, GGX = 0, 1
"""Tails, as the compiled code has them."""
TAILS = {"gaussian": GAUSSIAN, "ggx": GGX}
MAX_SLOPE = 1.2
"""Bound of a lobe's mean slopes: facets of 50°, whose lobe lights under the horizon would make."""
MAX_DIFFUSE_SLOPE = 1.0
"""Bound of the slopes of the diffuse normal: 45°."""


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def lobe(tail: int, p: Array, sx: float, sy: float, derivative: Array) -> float:
    """Value of a lobe at half-vector slopes (sx, sy); its derivatives by `p` go into `derivative` (5,)."""
    dx, dy = sx - p[0], sy - p[1]
    ea, ec = math.exp(p[2]), math.exp(p[4])
    u, v = ea * dx + p[3] * dy, ec * dy
    q = u * u + v * v
    if tail == GAUSSIAN:
        g = math.exp(-q)
        slope = -g
    else:
        g = 1.0 / ((1.0 + q) * (1.0 + q))
        slope = -2.0 * g / (1.0 + q)
    derivative[0] = -2.0 * slope * u * ea
    derivative[1] = -2.0 * slope * (u * p[3] + v * ec)
    derivative[2] = 2.0 * slope * u * ea * dx
    derivative[3] = 2.0 * slope * u * dy
    derivative[4] = 2.0 * slope * v * v
    return g


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def diffuse(p: Array, lx: float, ly: float, lz: float, derivative: Array) -> float:
    """Cosine at the light (lx, ly, lz) to the unnormalised normal (p₀, p₁, 1), and its derivatives (2,)."""
    cosine = lz + p[0] * lx + p[1] * ly
    if cosine <= 0.0:
        derivative[0] = derivative[1] = 0.0
        return 0.0
    derivative[0], derivative[1] = lx, ly
    return cosine


@njit(cache=True, nogil=True, error_model="numpy")
def set_widths(p: Array, a: float, b: float, d: float, narrow: float, wide: float) -> None:
    """Give the lobe `p` the matrix A = [[a, b], [b, d]] with its widths (1/e, along its axes) kept in bounds."""
    low, high = 1.0 / (wide * wide), 1.0 / (narrow * narrow)
    middle, radius = 0.5 * (a + d), math.hypot(0.5 * (a - d), b)
    first, second = middle + radius, middle - radius
    if not (first <= high and second >= low):
        first, second = min(max(first, low), high), min(max(second, low), high)
        scale = 0.5 * (first - second) / radius if radius > 0.0 else 0.0
        middle = 0.5 * (first + second)
        half, b = 0.5 * (a - d) * scale, b * scale
        a, d = middle + half, middle - half
    p[2] = 0.5 * math.log(a)
    p[3] = b / math.sqrt(a)
    # the determinant by the eigenvalues: d - b²/a would cancel for long thin lobes
    p[4] = 0.5 * math.log(first * second / a)


@njit(cache=True, nogil=True, error_model="numpy")
def confine(p: Array, lobes: int, narrow: float, wide: float) -> None:
    """Keep shapes in their bounds; a lobe that is not finite starts again in the middle, round."""
    for k in range(lobes):
        part = p[LOBE_SIZE * k : LOBE_SIZE * (k + 1)]
        finite = math.isfinite(part.sum()) and abs(part[2]) < 30.0 and abs(part[4]) < 30.0
        if not finite:
            part[:] = 0.0
            part[2] = part[4] = -0.5 * math.log(narrow * wide)
        for i in range(2):
            part[i] = min(max(part[i], -MAX_SLOPE), MAX_SLOPE)
        ea, ec = math.exp(part[2]), math.exp(part[4])
        set_widths(part, ea * ea, ea * part[3], part[3] * part[3] + ec * ec, narrow, wide)
    for i in range(LOBE_SIZE * lobes, p.size):
        if not math.isfinite(p[i]):
            p[i] = 0.0
        p[i] = min(max(p[i], -MAX_DIFFUSE_SLOPE), MAX_DIFFUSE_SLOPE)


def squared_widths(p: Array) -> tuple[Array, Array, Array]:
    """Squared-width matrix S = A⁻¹ of lobes (..., 5), as its elements (S_xx, S_xy, S_yy), each (...)."""
    ea, b, ec = np.exp(p[..., 2]), p[..., 3], np.exp(p[..., 4])
    # A = Uᵀ U with U = [[e^α, β], [0, e^γ]], so S = U⁻¹ U⁻ᵀ
    i00, i01, i11 = 1 / ea, -b / (ea * ec), 1 / ec
    return i00**2 + i01**2, i01 * i11, i11**2


def narrowest(p: Array) -> Array:
    """Smallest width (...) of lobes (..., 5), 1/e along their axes."""
    xx, xy, yy = squared_widths(p)
    return np.sqrt(np.maximum(0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy), 0))
