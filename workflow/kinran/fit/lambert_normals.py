"""Surface normals by Lambert's law, with the least absolute residuals."""

import numpy as np
from numpy.typing import NDArray

from kinran.data.lambert_law import solve
from kinran.fit.samples import Samples

Array = NDArray[np.float64]

ROUNDS = 10
"""Rounds of reweighting. A choice."""
LEAST = 1e-3
"""Share of the albedo that every residual counts for at least in the weights. A choice."""


def normals(samples: Samples) -> Array:
    """Fit normals with the least sum of absolute residuals from Lambert's law, by reweighted least squares.

    Highlights, cast shadows and light from neighbours are few and far from the law: unlike least squares, the sum of
    absolute residuals hardly moves for them. Lights below the surface's own horizon have no weight. [Ikehata2012]
    compares norms for this problem.

    Returns
    -------
    (texel, 3) float
        Unit vectors; N where a texel is black or has too few samples.
    """
    result = np.empty((len(samples), 3))
    for k, at in samples.under.cells():
        result[at] = _of_cell(samples.T[at], samples.W[at], samples.under.lights[k])
    return result


def _of_cell(T: NDArray[np.float32], W: NDArray[np.float32], lights: Array) -> Array:
    """Normals of texels under lights (light, 3)."""
    y = T.mean(1).astype(float)
    use = (W > 0).astype(float)
    scaled = solve(use, y, lights)
    for _ in range(ROUNDS):
        predicted = scaled @ lights.T
        floor = LEAST * np.linalg.norm(scaled, axis=1, keepdims=True) + 1e-12
        weight = use * (predicted > 0) / np.maximum(np.abs(y - predicted), floor)
        scaled = solve(weight * floor, y, lights)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    found = (length > 1e-9) & np.isfinite(length)
    return np.where(found, scaled / np.where(found, length, 1), [0.0, 0.0, 1.0])
