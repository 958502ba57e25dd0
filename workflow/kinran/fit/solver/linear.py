"""Small dense systems, compiled: Cholesky, and least squares over what cannot be negative."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

RIDGE = 1e-9
"""Share of its diagonal that is added to a matrix, so that columns that are the same do not divide by zero."""


@njit(cache=True, nogil=True, error_model="numpy")
def cholesky_solve(A: Array, b: Array, n: int, L: Array, x: Array) -> bool:
    """Solve the leading n×n system of symmetric A; False where A is not positive definite."""
    for i in range(n):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > 1e-300:
                    return False
                L[i, i] = math.sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    for i in range(n):
        s = b[i]
        for k in range(i):
            s -= L[i, k] * x[k]
        x[i] = s / L[i, i]
    for i in range(n - 1, -1, -1):
        s = x[i]
        for k in range(i + 1, n):
            s -= L[k, i] * x[k]
        x[i] = s / L[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def nonnegative(A: Array, b: Array, m: int, x: Array, work: Array) -> float:
    """Minimise xᵀAx - 2bᵀx over x ≥ 0 by trying every active set (m ≤ 3); returns the minimum.

    `work` (2m + 3, m) is scratch.
    """
    best = 0.0
    x[:m] = 0.0
    sub, L, right, y, index = work[:m], work[m : 2 * m], work[2 * m], work[2 * m + 1], work[2 * m + 2]
    for free in range((1 << m) - 1, 0, -1):
        n = 0
        for i in range(m):
            if (free >> i) & 1:
                index[n] = i
                n += 1
        for i in range(n):
            a = int(index[i])
            right[i] = b[a]
            for j in range(n):
                sub[i, j] = A[a, int(index[j])]
            sub[i, i] = sub[i, i] * (1.0 + RIDGE) + 1e-14
        if not cholesky_solve(sub, right, n, L, y):
            continue
        value = 0.0
        feasible = True
        for i in range(n):
            feasible &= y[i] >= 0.0
            value -= y[i] * right[i]
        if feasible and value < best:
            best = value
            x[:m] = 0.0
            for i in range(n):
                x[int(index[i])] = y[i]
        if feasible and free == (1 << m) - 1:
            break
    return best


@njit(cache=True, nogil=True, error_model="numpy")
def nonnegative2(A: Array, b: Array, x: Array) -> float:
    """`nonnegative` of two unknowns."""
    a, d = A[0, 0] * (1.0 + RIDGE) + 1e-14, A[1, 1] * (1.0 + RIDGE) + 1e-14
    determinant = a * d - A[0, 1] * A[0, 1]
    x[0], x[1] = (b[0] * d - b[1] * A[0, 1]) / determinant, (b[1] * a - b[0] * A[0, 1]) / determinant
    if not (determinant > 0.0 and x[0] >= 0.0 and x[1] >= 0.0):
        first, second = max(b[0], 0.0), max(b[1], 0.0)
        x[0], x[1] = (first / a, 0.0) if first * first * d >= second * second * a else (0.0, second / d)
    return -x[0] * b[0] - x[1] * b[1]


@njit(cache=True, nogil=True, error_model="numpy")
def invert(A: Array, n: int, out: Array) -> float:
    """Inverse of a symmetric matrix of two or three rows, by its cofactors; returns its determinant."""
    if n == 2:
        determinant = A[0, 0] * A[1, 1] - A[0, 1] * A[0, 1]
        out[0, 0], out[1, 1] = A[1, 1] / determinant, A[0, 0] / determinant
        out[0, 1] = out[1, 0] = -A[0, 1] / determinant
        return determinant
    for i in range(3):
        for j in range(3):
            r, s, c, e = (i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3
            out[i, j] = A[r, c] * A[s, e] - A[r, e] * A[s, c]
    determinant = A[0, 0] * out[0, 0] + A[0, 1] * out[0, 1] + A[0, 2] * out[0, 2]
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant
    return determinant
