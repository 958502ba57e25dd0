"""Interpolation of the samples over the light direction: linear in Delaunay triangles, or by thin plates [Duchon1977].

The weights are those of the directions from the field's centre, for all texels.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.spatial import Delaunay, QhullError

from kinran.base.frames import slopes
from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

Single = NDArray[np.float32]
Array = NDArray[np.float64]
Matrix = Callable[[Array, Array], Array]
"""Function from lights (m, 3) and other lights (n, 3) to weights (n, m)."""


@dataclass(frozen=True)
class Kept:
    """All samples T (texel, 3, light), their lights (light, 3), and the interpolation between them."""

    T: Single
    lights: Array
    matrix: Matrix
    shared: int = 0

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return float(3 * self.T.shape[2])

    def predict(self, under: Under) -> Single:
        """Values (texel, 3, light) under some lights, of the kind that was kept."""
        return np.asarray(self.T @ self.matrix(self.lights, under.directions).T.astype(np.float32))


def fit(samples: Samples, matrix: Matrix) -> Kept:
    """Keep the samples; `matrix` is `linear` or `thin_plate`."""
    return Kept(samples.T, samples.under.directions, matrix)


def linear(lights: Array, others: Array) -> Array:
    """Barycentric weights (n, m) in the Delaunay triangles of the half-vector slopes.

    Outside the hull, and where the lights have no triangle, the two nearest lights are weighted by inverse distance.
    """
    a, b = slopes(lights), slopes(others)
    weights = np.zeros((len(b), len(a)))
    try:
        triangles = Delaunay(a)
        inside = triangles.find_simplex(b)
    except (QhullError, ValueError):  # fewer than three lights, or all on one line
        inside = np.full(len(b), -1)
    for i, simplex in enumerate(inside):
        if simplex >= 0:
            transform = triangles.transform[simplex]
            part = transform[:2] @ (b[i] - transform[2])
            weights[i, triangles.simplices[simplex]] = [*part, 1 - part.sum()]
            continue
        distance = np.linalg.norm(a - b[i], axis=1)
        near = np.argsort(distance, kind="stable")[:2]
        inverse = 1 / np.maximum(distance[near], 1e-9)
        weights[i, near] = inverse / inverse.sum()
    return weights


def thin_plate(smoothing: float) -> Matrix:
    """Weights (n, m) of the thin-plate spline over (l_x, l_y), with this much smoothing."""

    def weights(lights: Array, others: Array) -> Array:
        spline = RBFInterpolator(
            lights[:, :2], np.eye(len(lights)), kernel="thin_plate_spline", smoothing=smoothing, degree=1
        )
        return np.asarray(spline(others[:, :2]))

    return weights
