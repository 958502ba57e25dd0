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
DIFFUSE_SIZE = 2
GAUSSIAN, GGX = 0, 1
TAILS = {"gaussian": GAUSSIAN, "ggx": GGX}


@njit(cache=True, nogil=True, inline="always")
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


@njit(cache=True, nogil=True, inline="always")
def diffuse(p: Array, lx: float, ly: float, lz: float, derivative: Array) -> float:
    """Cosine at the light (lx, ly, lz) to the unnormalised normal (p₀, p₁, 1), and its derivatives (2,)."""
    cosine = lz + p[0] * lx + p[1] * ly
    if cosine <= 0.0:
        derivative[0] = derivative[1] = 0.0
        return 0.0
    derivative[0], derivative[1] = lx, ly
    return cosine


def squared_widths(p: Array) -> tuple[Array, Array, Array]:
    """Squared-width matrix S = A⁻¹ of lobes (..., 5), as its elements (S_xx, S_xy, S_yy), each (...)."""
    ea, b, ec = np.exp(p[..., 2]), p[..., 3], np.exp(p[..., 4])
    # A = Uᵀ U with U = [[e^α, β], [0, e^γ]], so S = U⁻¹ U⁻ᵀ
    i00, i01, i11 = 1 / ea, -b / (ea * ec), 1 / ec
    return i00**2 + i01**2, i01 * i11, i11**2
