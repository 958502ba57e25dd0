"""Gauss-Newton Hessians of fitted texels and their inverses, compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE, diffuse, lobe

Array = NDArray[np.float64]
Single = NDArray[np.float32]


@njit(cache=True, nogil=True)
def covariances(
    tail: int, P: Array, C: Array, T: Single, W: Single, s: Array, light: Array, stiffness: Array, out: Array
) -> None:
    """Fill `out` (texel, total, total)."""
    size, columns, total = P.shape[1], C.shape[1], out.shape[1]
    lobes = columns - 1
    x, gram, N = np.empty(size + columns), np.empty((size + columns, size + columns)), np.empty((total, total))
    free, scale = np.empty(total, np.bool_), np.empty(total)
    for t in range(len(P)):
        gram[:], cost, used = 0.0, 0.0, 0
        for i in range(len(s)):
            w = W[t, i]
            if w <= 0.0:
                continue
            used += 1
            for k in range(lobes):
                at = LOBE_SIZE * k
                x[size + k] = lobe(tail, P[t, at : at + LOBE_SIZE], s[i, 0], s[i, 1], x[at : at + LOBE_SIZE])
            normal = P[t, size - DIFFUSE_SIZE :]
            x[size + lobes] = diffuse(normal, light[i, 0], light[i, 1], light[i, 2], x[size - DIFFUSE_SIZE : size])
            for c in range(3):
                left = T[t, c, i]
                for k in range(columns):
                    left -= C[t, k, c] * x[size + k]
                cost += w * left * left
            for a in range(size + columns):
                for b in range(a + 1):
                    gram[a, b] += w * x[a] * x[b]
        normal_matrix(gram, C[t], size, N)
        for a in range(size):
            N[a, a] += stiffness[t, a]
        for a in range(total):
            free[a] = N[a, a] > 0.0
            scale[a] = 1.0 / np.sqrt(N[a, a]) if free[a] else 1.0
        for a in range(total):
            for b in range(total):
                N[a, b] = N[a, b] * scale[a] * scale[b] if free[a] and free[b] else 0.0
            N[a, a] = 1.0 + 1e-10
        inverse = np.linalg.inv(N)
        variance = cost / max(3.0 * used - total, 1.0)
        for a in range(total):
            for b in range(total):
                out[t, a, b] = variance * inverse[a, b] * scale[a] * scale[b]
            if not free[a]:
                out[t, a, a] = np.inf


@njit(cache=True, nogil=True)
def normal_matrix(gram: Array, C: Array, size: int, N: Array) -> None:
    """JᵀWJ of three channels, from the products (size + columns)² of the derivatives and values of one."""
    columns = len(C)
    N[:] = 0.0
    for a in range(size):
        ka = min(a // LOBE_SIZE, columns - 1)
        for b in range(a + 1):
            kb = min(b // LOBE_SIZE, columns - 1)
            N[a, b] = N[b, a] = gram[a, b] * (C[ka, 0] * C[kb, 0] + C[ka, 1] * C[kb, 1] + C[ka, 2] * C[kb, 2])
        for k in range(columns):
            for c in range(3):
                N[a, size + 3 * k + c] = N[size + 3 * k + c, a] = gram[size + k, a] * C[ka, c]
    for k in range(columns):
        for m in range(k + 1):
            for c in range(3):
                value = gram[size + k, size + m]
                N[size + 3 * k + c, size + 3 * m + c] = N[size + 3 * m + c, size + 3 * k + c] = value
