"""Directions and frames: Kinran's geometric conventions.

X is the weft (image column, +u), Y the warp (up in the image, +v), N points to the camera; right-handed.
θ is measured from N, φ from X towards Y (Takeda2008, Fig. 2). Directions point away from the surface.
The view is V = N, so that θ_h = θ_l / 2 and φ_h = φ_l.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def direction(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Return the unit vectors of polar angles.

    Parameters
    ----------
    theta, phi : (...) float
        Polar angle from N and azimuth from X towards Y, in radians.

    Returns
    -------
    (..., 3) float
    """
    theta, phi = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    sin = np.sin(theta)
    return np.stack([sin * np.cos(phi), sin * np.sin(phi), np.cos(theta)], -1)


def angles(vectors: ArrayLike) -> tuple[Array, Array]:
    """Return the polar angles (θ, φ) in radians of vectors (..., 3) of any length; φ in [0, 2π), 0 at the pole."""
    v = np.asarray(vectors, float)
    radius = np.hypot(v[..., 0], v[..., 1])
    phi = np.where(radius > 0, np.arctan2(v[..., 1], v[..., 0]), 0.0)
    return np.arctan2(radius, v[..., 2]), np.mod(phi, 2 * np.pi)


def half_vector(lights: ArrayLike) -> Array:
    """Return the half vectors (..., 3) of unit light directions (..., 3) and the view V = N."""
    h = np.asarray(lights, float) + np.array([0.0, 0.0, 1.0])
    return np.asarray(h / np.linalg.norm(h, axis=-1, keepdims=True))


def slopes(lights: ArrayLike) -> Array:
    """Return the half vectors' slopes (h_x / h_z, h_y / h_z), (..., 2), of unit light directions (..., 3) and V = N."""
    v = np.asarray(lights, float)
    return v[..., :2] / (1.0 + v[..., 2:])


def nearest(points: Array, count: int) -> tuple[Array, NDArray[np.intp]]:
    """Return the distances and the numbers (point, count) of the nearest points (point, 2), each itself first.

    They are `count`, or as many as there are. A few thousand points take less time than to import a library's tree.
    """
    found = []
    for start in range(0, len(points), 256):
        squared = np.square(points[start : start + 256, None] - points).sum(-1)
        squared[np.arange(len(squared)), start + np.arange(len(squared))] = -1
        found.append(np.argsort(squared, axis=1, kind="stable")[:, :count])
    numbers = np.concatenate(found)
    return np.linalg.norm(points[:, None] - points[numbers], axis=-1), numbers


def wrap(angle: ArrayLike) -> Array:
    """Return differences of azimuths, in radians, wrapped to [-π, π)."""
    return np.mod(np.asarray(angle, float) + np.pi, 2 * np.pi) - np.pi
