"""Thin plates over θ (cos φ, sin φ), as a material holds them: splines over (l_x, l_y) through many nodes."""

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran_bsdf.residual import kernel_matrix, spline

Array = NDArray[np.float64]

NODES = 160
"""Directions, besides the lights, that the spline of a material goes through."""
CROWDED = 0.4
"""Exponent of their spread in θ: 0.5 is even in the plane of angles, less is closer near the horizon."""


def plane(lights: Array) -> Array:
    """θ (cos φ, sin φ) of lights (n, 3): rings even in θ stay so, where (l_x, l_y) crowds those near the horizon."""
    theta, phi = frames.angles(lights)
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], -1)


def plates(lights: Array, values: Array, smoothing: float) -> tuple[Array, Array]:
    """Smooth functions of the light from values at some lights.

    Photographs vary evenly with the angle of the light, but a material's splines are over (l_x, l_y). So thin plates
    are laid over the angles, and a spline over (l_x, l_y) goes through what they say at `NODES` more directions.

    Parameters
    ----------
    lights : (m, 3) float
    values : (m, k) float
    smoothing
        Of the plates; 0 goes through the values.

    Returns
    -------
    nodes : (n, 2) float
        (l_x, l_y): the lights, then the other directions.
    weights : (n + 3, k) float
        As of `kinran_bsdf.residual.Residual`.
    """
    k = np.arange(NODES) + 0.5
    spread = frames.direction(0.5 * np.pi * (k / NODES) ** CROWDED, k * np.pi * (3 - 5**0.5))
    at, other = plane(lights), plane(spread)
    distance = np.linalg.norm(other[:, None] - at[None], axis=-1).min(1)
    nodes = np.concatenate([lights, spread[distance > 0.4 * np.pi / NODES**0.5]])
    smooth = kernel_matrix(plane(nodes), at) @ spline(at, values, smoothing)
    return nodes[:, :2], spline(nodes, smooth, 0.0)
