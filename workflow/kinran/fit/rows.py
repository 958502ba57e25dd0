"""Rows of weighted lobes, derivatives and residuals in single precision, and their products."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.lobes import GAUSSIAN

Array = NDArray[np.float64]
Single = NDArray[np.float32]
f4 = np.float32

FINITE = {"reassoc", "contract", "nsz", "arcp"}
"""Fast arithmetic that still knows NaN and infinity."""
LARGEST = f4(3e38)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def exponential(x: f4) -> f4:
    """e^x of single precision for x ≤ 0: 2^fraction by a polynomial, 2^whole by its bits."""
    t = max(x * f4(1.44269504), f4(-126.0))
    whole = np.floor(t)
    f = t - whole
    p = f4(0.0089893397) + f * f4(0.0018775767)
    p = f4(1.0) + f * (f4(0.69315308) + f * (f4(0.24015361) + f * (f4(0.0558263180) + f * p)))
    return p * np.int32((np.int32(whole) + np.int32(127)) << np.int32(23)).view(np.float32)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True, inline="always")
def profile(tail: int, q: f4) -> tuple[f4, f4]:
    """G(q) of a tail and -dG/dq."""
    if tail == GAUSSIAN:
        g = exponential(-q)
        return g, g
    r = f4(1.0) / (f4(1.0) + q)
    g = r * r
    return g, f4(2.0) * g * r


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def gram(R: Single, M: Array) -> None:
    """Lower triangle of M = R Rᵀ for R (rows, light) with rows a multiple of 4."""
    n = R.shape[1]
    for a in range(0, R.shape[0], 4):
        r0, r1, r2, r3 = R[a], R[a + 1], R[a + 2], R[a + 3]
        for b in range(0, a, 4):
            c0, c1, c2, c3 = R[b], R[b + 1], R[b + 2], R[b + 3]
            m00 = m01 = m02 = m03 = m10 = m11 = m12 = m13 = f4(0)
            m20 = m21 = m22 = m23 = m30 = m31 = m32 = m33 = f4(0)
            for i in range(n):
                x0, x1, x2, x3, y0, y1, y2, y3 = r0[i], r1[i], r2[i], r3[i], c0[i], c1[i], c2[i], c3[i]
                m00, m01, m02, m03 = m00 + x0 * y0, m01 + x0 * y1, m02 + x0 * y2, m03 + x0 * y3
                m10, m11, m12, m13 = m10 + x1 * y0, m11 + x1 * y1, m12 + x1 * y2, m13 + x1 * y3
                m20, m21, m22, m23 = m20 + x2 * y0, m21 + x2 * y1, m22 + x2 * y2, m23 + x2 * y3
                m30, m31, m32, m33 = m30 + x3 * y0, m31 + x3 * y1, m32 + x3 * y2, m33 + x3 * y3
            M[a, b], M[a, b + 1], M[a, b + 2], M[a, b + 3] = m00, m01, m02, m03
            M[a + 1, b], M[a + 1, b + 1], M[a + 1, b + 2], M[a + 1, b + 3] = m10, m11, m12, m13
            M[a + 2, b], M[a + 2, b + 1], M[a + 2, b + 2], M[a + 2, b + 3] = m20, m21, m22, m23
            M[a + 3, b], M[a + 3, b + 1], M[a + 3, b + 2], M[a + 3, b + 3] = m30, m31, m32, m33
        m00 = m10 = m11 = m20 = m21 = m22 = m30 = m31 = m32 = m33 = f4(0)
        for i in range(n):
            x0, x1, x2, x3 = r0[i], r1[i], r2[i], r3[i]
            m00, m10, m11 = m00 + x0 * x0, m10 + x1 * x0, m11 + x1 * x1
            m20, m21, m22 = m20 + x2 * x0, m21 + x2 * x1, m22 + x2 * x2
            m30, m31, m32, m33 = m30 + x3 * x0, m31 + x3 * x1, m32 + x3 * x2, m33 + x3 * x3
        M[a, a], M[a + 1, a], M[a + 1, a + 1] = m00, m10, m11
        M[a + 2, a], M[a + 2, a + 1], M[a + 2, a + 2] = m20, m21, m22
        M[a + 3, a], M[a + 3, a + 1], M[a + 3, a + 2], M[a + 3, a + 3] = m30, m31, m32, m33


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def lobe_values(tail: int, p: Array, S: Single, root: Single, g: Single, scale: Single) -> None:
    """Weighted values g of a lobe, and twice its weighted -dG/dq."""
    mx, my, ea, b, ec = f4(p[0]), f4(p[1]), f4(math.exp(p[2])), f4(p[3]), f4(math.exp(p[4]))
    sx, sy = S[0], S[1]
    for i in range(root.size):
        dy = sy[i] - my
        u, v = ea * (sx[i] - mx) + b * dy, ec * dy
        value, steepness = profile(tail, u * u + v * v)
        g[i] = value * root[i]
        scale[i] = f4(2.0) * steepness * root[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def lobe_derivatives(p: Array, S: Single, scale: Single, D: Single) -> None:
    """Weighted derivatives D (5, light) of a lobe by its shape."""
    # loops of few arrays: those the compiler can tell apart and vectorise
    mx, my, ea, b, ec = f4(p[0]), f4(p[1]), f4(math.exp(p[2])), f4(p[3]), f4(math.exp(p[4]))
    sx, sy = S[0], S[1]
    d0, d1, d2, d3, d4 = D[0], D[1], D[2], D[3], D[4]
    for i in range(scale.size):
        dy = sy[i] - my
        u = scale[i] * (ea * (sx[i] - mx) + b * dy)
        d0[i], d1[i] = u * ea, u * b + scale[i] * ec * ec * dy
    for i in range(scale.size):
        dx, dy = sx[i] - mx, sy[i] - my
        u = scale[i] * (ea * dx + b * dy)
        d2[i], d3[i] = -u * ea * dx, -u * dy
    for i in range(scale.size):
        v = ec * (sy[i] - my)
        d4[i] = -scale[i] * v * v


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def diffuse_rows(x: float, y: float, L: Single, root: Single, D: Single, m: Single) -> None:
    """Rows of the diffuse term: its derivatives D (2, light) by the slopes of its normal and its values."""
    nx, ny, lx, ly, lz, dx, dy = f4(x), f4(y), L[0], L[1], L[2], D[0], D[1]
    for i in range(root.size):
        m[i] = max(lz[i] + nx * lx[i] + ny * ly[i], f4(0.0)) * root[i]
    for i in range(root.size):
        dx[i] = lx[i] * root[i] if m[i] > f4(0.0) else f4(0.0)
    for i in range(root.size):
        dy[i] = ly[i] * root[i] if m[i] > f4(0.0) else f4(0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def remainder(y: Single, a: Single, b: Single, fa: float, fb: float, out: Single) -> None:
    """The rest y - fa · a - fb · b."""
    ka, kb = f4(fa), f4(fb)
    for i in range(y.size):
        out[i] = y[i] - ka * a[i] - kb * b[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def scaled(y: Single, root: Single, out: Single) -> None:
    """Weighted values root · y."""
    for i in range(y.size):
        out[i] = root[i] * y[i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def dot(a: Single, b: Single) -> float:
    """Inner product."""
    s = f4(0)
    for i in range(a.size):
        s += a[i] * b[i]
    return float(s)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FINITE)
def take(T: Single, W: Single, root: Single, Y: Single, y: Single) -> None:
    """Roots of the weights, weighted data Y (3, light) and mean of the channels y; without what is not finite."""
    t0, t1, t2 = T[0], T[1], T[2]
    for i in range(W.size):
        y[i] = (t0[i] + t1[i] + t2[i]) * f4(1 / 3)
    for i in range(W.size):
        root[i] = np.sqrt(max(W[i], f4(0.0))) if abs(y[i]) <= LARGEST else f4(0.0)
    for i in range(W.size):
        y[i] = y[i] if root[i] > f4(0.0) else f4(0.0)
    for c in range(3):
        t, out = T[c], Y[c]
        for i in range(W.size):
            out[i] = root[i] * t[i] if root[i] > f4(0.0) else f4(0.0)
