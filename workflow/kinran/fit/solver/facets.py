"""Facets of texels by Lambert's law, compiled."""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]

ROUNDS = 10
"""Rounds of reweighting. A choice."""
LEAST = 1e-3
"""Share of the albedo that every residual counts for at least in the weights. A choice."""
RIDGE = 1e-9
"""Share of the trace of a normal matrix that is added to its diagonal."""


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})
def facets(T: Single, W: Single, L: Array, scaled: Array) -> None:
    """Fit normals times albedos with the least absolute residuals from Lambert's law, by reweighted least squares.

    Parameters
    ----------
    T, W : (texel, 3, light), (texel, light)
        Samples and their weights, of which only the sign counts.
    L : (3, light)
        Unit vectors to the lights.
    scaled : (texel, 3)
        Result; 0 where a texel has no samples.
    """
    lights = L.shape[1]
    y, weight = np.empty(lights), np.empty(lights)
    X, Y, Z = L[0], L[1], L[2]
    for t in range(len(T)):
        for i in range(lights):
            weight[i] = 1.0 if W[t, i] > 0.0 else 0.0
            y[i] = (T[t, 0, i] + T[t, 1, i] + T[t, 2, i]) / 3.0 if W[t, i] > 0.0 else 0.0
        x0, x1, x2 = 0.0, 0.0, 0.0
        for turn in range(ROUNDS + 1):
            if turn:
                floor = LEAST * math.sqrt(x0 * x0 + x1 * x1 + x2 * x2) + 1e-12
                for i in range(lights):
                    predicted = x0 * X[i] + x1 * Y[i] + x2 * Z[i]
                    share = floor / max(abs(y[i] - predicted), floor)
                    weight[i] = share if W[t, i] > 0.0 and predicted > 0.0 else 0.0
            xx, xy, xz, yy, yz, zz, bx, by, bz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(lights):
                a, b, c = weight[i] * X[i], weight[i] * Y[i], weight[i] * Z[i]
                xx += a * X[i]
                xy += a * Y[i]
                xz += a * Z[i]
                yy += b * Y[i]
                yz += b * Z[i]
                zz += c * Z[i]
                bx += a * y[i]
                by += b * y[i]
                bz += c * y[i]
            ridge = RIDGE * (xx + yy + zz) + 1e-30
            xx, yy, zz = xx + ridge, yy + ridge, zz + ridge
            # Cholesky's factors of the normal matrix
            l11 = math.sqrt(xx)
            l21, l31 = xy / l11, xz / l11
            l22 = math.sqrt(max(yy - l21 * l21, ridge))
            l32 = (yz - l21 * l31) / l22
            l33 = math.sqrt(max(zz - l31 * l31 - l32 * l32, ridge))
            v0 = bx / l11
            v1 = (by - l21 * v0) / l22
            v2 = (bz - l31 * v0 - l32 * v1) / l33
            x2 = v2 / l33
            x1 = (v1 - l32 * x2) / l22
            x0 = (v0 - l21 * x1 - l31 * x2) / l11
        scaled[t, 0], scaled[t, 1], scaled[t, 2] = x0, x1, x2
