"""Rows of weighted lobes, derivatives and residuals in single precision, and their products."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.lobes import GAUSSIAN

Array = NDArray[np.float64]
Single = NDArray[np.float32]
f4 = np.float32

FINITE = {"reassoc", "contract", "nsz", "arcp"}
"""Fast arithmetic that still knows NaN and infinity."""
LARGEST = f4(3e38)
"""Samples over this are not finite in single precision."""
FAR = f4(25.0)
"""Squared distance from a Gaussian lobe at which there is nothing of it."""
LANES = 32
"""Rows are as long as a multiple of this, so that loops over them leave no rest; what is too long is 0."""


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
        # products of what is smaller would be denormal, which processors multiply a hundred times slower
        g = exponential(-q) if q < FAR else f4(0.0)
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
def lobe_rows(tail: int, p: Array, at: int, S: Single, root: Single, scale: Single, R: Single, value: int) -> None:
    """Weighted values of the lobe p[at : at + 5] into the row `value` of R, its derivatives into rows `at` and on."""
    mx, my, ea, b, ec = f4(p[at]), f4(p[at + 1]), f4(math.exp(p[at + 2])), f4(p[at + 3]), f4(math.exp(p[at + 4]))
    # loops of few rows: those the compiler can tell apart and vectorise
    for i in range(root.size):
        dy = S[1, i] - my
        u, v = ea * (S[0, i] - mx) + b * dy, ec * dy
        g, steepness = profile(tail, u * u + v * v)
        R[value, i] = g * root[i]
        scale[i] = f4(2.0) * steepness * root[i]
    for i in range(root.size):
        dy = S[1, i] - my
        u = scale[i] * (ea * (S[0, i] - mx) + b * dy)
        R[at, i], R[at + 1, i] = u * ea, u * b + scale[i] * ec * ec * dy
    for i in range(root.size):
        dx, dy = S[0, i] - mx, S[1, i] - my
        u = scale[i] * (ea * dx + b * dy)
        R[at + 2, i], R[at + 3, i] = -u * ea * dx, -u * dy
    for i in range(root.size):
        v = ec * (S[1, i] - my)
        R[at + 4, i] = -scale[i] * v * v


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def diffuse_rows(p: Array, at: int, L: Single, root: Single, R: Single, value: int) -> None:
    """Weighted values of the diffuse term, and its derivatives (rows `at` and on) by its slopes p[at : at + 2]."""
    nx, ny = f4(p[at]), f4(p[at + 1])
    for i in range(root.size):
        R[value, i] = max(L[2, i] + nx * L[0, i] + ny * L[1, i], f4(0.0)) * root[i]
    for k in range(2):
        for i in range(root.size):
            R[at + k, i] = L[k, i] * root[i] if R[value, i] > f4(0.0) else f4(0.0)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def remainder(Y: Single, c: int, R: Single, value: int, columns: int, C: Array, rest: int) -> None:
    """Row `rest` of R: what colours C (columns, channel) of the rows from `value` leave of the channel c."""
    first, last, diffuse = f4(C[0, c]), f4(C[columns - 1, c]), value + columns - 1
    if columns == 2:
        for i in range(R.shape[1]):
            R[rest, i] = Y[c, i] - first * R[value, i] - last * R[diffuse, i]
    else:
        second = f4(C[1, c])
        for i in range(R.shape[1]):
            R[rest, i] = Y[c, i] - first * R[value, i] - second * R[value + 1, i] - last * R[diffuse, i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def along(Y: Single, colour: Array, out: Single) -> None:
    """Data along a colour (3,)."""
    a, b, d = f4(colour[0]), f4(colour[1]), f4(colour[2])
    for i in range(Y.shape[1]):
        out[0, i] = a * Y[0, i] + b * Y[1, i] + d * Y[2, i]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=True)
def lobe_products(tail: int, p: Array, S: Single, root: Single, m: Single, Y: Single, A: Array, B: Array) -> float:
    """Products of a lobe g and the diffuse row m: among themselves A (2, 2), with the channels B (2, 3); and Y · Y."""
    mx, my, ea, b, ec = f4(p[0]), f4(p[1]), f4(math.exp(p[2])), f4(p[3]), f4(math.exp(p[4]))
    gg = gm = mm = g0 = g1 = g2 = m0 = m1 = m2 = yy = f4(0)
    for i in range(root.size):
        dy = S[1, i] - my
        u, v = ea * (S[0, i] - mx) + b * dy, ec * dy
        g = profile(tail, u * u + v * v)[0] * root[i]
        y0, y1, y2 = Y[0, i], Y[1, i], Y[2, i]
        gg, gm, mm = gg + g * g, gm + g * m[i], mm + m[i] * m[i]
        g0, g1, g2 = g0 + g * y0, g1 + g * y1, g2 + g * y2
        m0, m1, m2 = m0 + m[i] * y0, m1 + m[i] * y1, m2 + m[i] * y2
        yy += y0 * y0 + y1 * y1 + y2 * y2
    A[0, 0], A[0, 1], A[1, 0], A[1, 1] = gg, gm, gm, mm
    B[0, 0], B[0, 1], B[0, 2], B[1, 0], B[1, 1], B[1, 2] = g0, g1, g2, m0, m1, m2
    return float(yy)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FINITE)
def take(T: Single, W: Single, t: int, root: Single, Y: Single, y: Single) -> None:
    """Roots of the weights, weighted data Y (3, light) and mean of the channels y; without what is not finite."""
    n = W.shape[1]
    for i in range(n):
        y[i] = (T[t, 0, i] + T[t, 1, i] + T[t, 2, i]) * f4(1 / 3)
    for i in range(n):
        used = W[t, i] > f4(0.0) and abs(y[i]) <= LARGEST
        root[i], y[i] = W[t, i] if used else f4(0.0), y[i] if used else f4(0.0)
    own = 0  # weights of 0 and 1 are their own roots
    for i in range(n):
        own += 1 if root[i] * root[i] == root[i] else 0
    if own < n:
        for i in range(n):
            root[i] = np.sqrt(root[i])
    for c in range(3):
        for i in range(n):
            Y[c, i] = root[i] * T[t, c, i] if root[i] > f4(0.0) else f4(0.0)
