"""Surface normals by Lambert's law, with the least absolute residuals."""

import numpy as np
from numpy.typing import NDArray

from kinran.fit.samples import Samples
from kinran.fit.solver import prepare
from kinran.fit.solver.facets import facets

Array = NDArray[np.float64]


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
    prepare()
    result = np.empty((len(samples), 3))
    for k, at in samples.under.cells():
        result[at] = _of_cell(samples.T[at], samples.W[at], samples.under.lights[k])
    return result


def _of_cell(T: NDArray[np.float32], W: NDArray[np.float32], lights: Array) -> Array:
    """Normals of texels under lights (light, 3)."""
    scaled = np.empty((len(T), 3))
    facets(np.ascontiguousarray(T), np.ascontiguousarray(W), np.ascontiguousarray(lights.T), scaled)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    found = (length > 1e-9) & np.isfinite(length)
    return np.where(found, scaled / np.where(found, length, 1), [0.0, 0.0, 1.0])
