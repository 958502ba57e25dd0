"""How well the samples fix the parameters of a fit: covariances from the Gauss-Newton Hessian."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran import frames
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, diffuse, lobe
from kinran.fit.slope import SlopeFit

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

BLOCK = 256
"""Texels of a job of a thread."""


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of shapes (texel, K) and colours (texel, lobes + 1, 3); infinite where nothing fixes them."""

    shapes: Array
    colours: Array


def deviations(
    fitted: SlopeFit,
    T: Samples,
    W: Samples,
    lights: Array,
    tail: str = "ggx",
    stiffness: Array | None = None,
) -> Deviations:
    """Standard deviations of a fit; parameters as of `covariances`."""
    covariance = covariances(fitted.shapes, fitted.colours, T, W, lights, tail, stiffness)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    size = fitted.shapes.shape[1]
    return Deviations(sd[:, :size], sd[:, size:].reshape(fitted.colours.shape))


def covariances(
    shapes: Array,
    colours: Array,
    T: Samples,
    W: Samples,
    lights: Array,
    tail: str = "ggx",
    stiffness: Array | None = None,
    slopes: Array | None = None,
    threads: int = 1,
) -> Array:
    """Covariance matrix of shapes and colours together, σ² (JᵀWJ + ρ)⁻¹.

    σ² is the texel's own mean squared residual, so that what the model cannot say counts as noise.

    Parameters
    ----------
    shapes, colours : (texel, K), (texel, lobes + 1, 3)
        Of a `kinran.fit.slope.SlopeFit`.
    T, W, lights, tail, slopes, threads
        As given to `kinran.fit.slope.fit`.
    stiffness : (texel, K)
        ρ of the prior, if there was one.

    Returns
    -------
    (texel, K + 3 (lobes + 1), K + 3 (lobes + 1))
        Infinite on the diagonal where nothing fixes a parameter.
    """
    weights = np.where(np.isfinite(T).all(1), W, 0).astype(np.float32)
    P, C = np.ascontiguousarray(shapes, float), np.ascontiguousarray(colours, float)
    rho = np.zeros_like(P) if stiffness is None else np.ascontiguousarray(stiffness, float)
    directions = np.ascontiguousarray(lights, float)
    s = np.ascontiguousarray(frames.slopes(directions) if slopes is None else slopes, float)
    total = P.shape[1] + 3 * C.shape[1]
    out = np.empty((len(P), total, total))

    def block(at: slice) -> None:
        _covariances(TAILS[tail], P[at], C[at], T[at], weights[at], s, directions, rho[at], out[at])

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, [slice(k, k + BLOCK) for k in range(0, len(P), BLOCK)]))
    return out


@njit(cache=True, nogil=True)
def _covariances(
    tail: int, P: Array, C: Array, T: Samples, W: Samples, s: Array, light: Array, stiffness: Array, out: Array
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
        _normal_matrix(gram, C[t], size, N)
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
def _normal_matrix(gram: Array, C: Array, size: int, N: Array) -> None:
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
