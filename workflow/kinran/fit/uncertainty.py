"""How well the samples fix the parameters of a fit: standard deviations from the Gauss-Newton Hessian."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran import frames
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, diffuse, lobe
from kinran.fit.slope import SlopeFit

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Deviations:
    """Standard deviations of shapes (texel, K) and colours (texel, lobes + 1, 3); infinite where nothing fixes them."""

    shapes: Array
    colours: Array


def deviations(
    fitted: SlopeFit,
    T: NDArray[np.float32],
    W: NDArray[np.float32],
    lights: Array,
    tail: str = "ggx",
    stiffness: Array | None = None,
) -> Deviations:
    """Standard deviations of a fit.

    Noise is taken to be as large as the residual, by texel, so that what the model cannot say counts as noise.

    Parameters
    ----------
    fitted, T, W, lights, tail
        As given by and to `kinran.fit.slope.fit`.
    stiffness : (texel, K)
        Of the prior, if there was one.
    """
    W = np.where(np.isfinite(T).all(1), W, 0).astype(np.float32)
    if stiffness is None:
        stiffness = np.zeros_like(fitted.shapes)
    variances = np.empty((len(T), fitted.shapes.shape[1] + 3 * fitted.colours.shape[1]))
    directions = np.ascontiguousarray(lights, float)
    s = np.ascontiguousarray(frames.slopes(directions))
    _variances(TAILS[tail], fitted.shapes, fitted.colours, W, s, directions, stiffness, variances)
    freedom = np.maximum(3.0 * (W > 0).sum(1) - variances.shape[1], 1.0)
    # a coordinate whose curvature is nothing has no bound
    sd = np.sqrt(np.where(variances > 0, variances * (fitted.cost / freedom)[:, None], np.inf))
    size = fitted.shapes.shape[1]
    return Deviations(sd[:, :size], sd[:, size:].reshape(fitted.colours.shape))


@njit(cache=True, nogil=True)
def _variances(
    tail: int, P: Array, C: Array, W: NDArray[np.float32], s: Array, light: Array, stiffness: Array, out: Array
) -> None:
    """Diagonal of (JᵀWJ + ρ)⁻¹ of shapes and colours together; 0 where a parameter has no effect."""
    size, columns = P.shape[1], C.shape[1]
    total, lobes = out.shape[1], columns - 1
    D, G, J = np.empty(size), np.empty(columns), np.empty(total)
    for t in range(len(P)):
        N = np.zeros((total, total))
        for i in range(len(s)):
            if W[t, i] <= 0.0:
                continue
            for k in range(lobes):
                at = LOBE_SIZE * k
                G[k] = lobe(tail, P[t, at : at + LOBE_SIZE], s[i, 0], s[i, 1], D[at : at + LOBE_SIZE])
            G[lobes] = diffuse(
                P[t, size - DIFFUSE_SIZE :], light[i, 0], light[i, 1], light[i, 2], D[LOBE_SIZE * lobes :]
            )
            for c in range(3):
                J[size:] = 0.0
                for k in range(size):
                    J[k] = C[t, min(k // LOBE_SIZE, lobes), c] * D[k]
                for k in range(columns):
                    J[size + 3 * k + c] = G[k]
                for a in range(total):
                    for b in range(a + 1):
                        N[a, b] += W[t, i] * J[a] * J[b]
        for a in range(size):
            N[a, a] += stiffness[t, a]
        free = np.zeros(total, np.bool_)
        for a in range(total):
            free[a] = N[a, a] > 0.0
            for b in range(a):
                N[b, a] = N[a, b]
        scale = np.ones(total)
        for a in range(total):
            scale[a] = 1.0 / np.sqrt(N[a, a]) if free[a] else 1.0
        for a in range(total):
            for b in range(total):
                N[a, b] = N[a, b] * scale[a] * scale[b] if free[a] and free[b] else 0.0
            N[a, a] = 1.0 + 1e-10
        inverse = np.linalg.inv(N)
        for a in range(total):
            out[t, a] = inverse[a, a] * scale[a] * scale[a] if free[a] else 0.0
