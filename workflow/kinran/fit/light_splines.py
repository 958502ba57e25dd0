"""Smooth functions of the light, in the form that a material holds: splines over (l_x, l_y) with many nodes.

Thin plates over θ (cos φ, sin φ) follow relief and shadows. Where only reflectance is left to model, a few
hemispherical harmonics are smoother than thin plates between rings of lights.
"""

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.fit.harmonics import harmonics
from kinran_bsdf.residual import kernel_matrix, spline

Array = NDArray[np.float64]

NODES = 160
"""Directions, besides the lights, that the spline of a material goes through. A choice."""
HARMONICS, RIDGE = 16, 1e-6
"""Number of hemispherical harmonics, and ridge of their normal matrix over the mean of its diagonal. Choices."""
DENSE, NOISE = 1500, 1e-10
"""Directions at which a spline is fitted to harmonics, and least relative singular value of that fit. Choices."""
CROWDED = 0.4
"""Exponent of the spread of the nodes in θ: at 0.5 they are even in the plane of angles, below it they are denser
near the horizon. A choice."""


def plane(lights: Array) -> Array:
    """Points θ (cos φ, sin φ), (n, 2), of lights (n, 3).

    Rings that are even in θ stay even here, while (l_x, l_y) crowds those near the horizon.
    """
    theta, phi = frames.angles(lights)
    return np.stack([theta * np.cos(phi), theta * np.sin(phi)], -1)


def plates(lights: Array, values: Array, smoothing: float | None) -> tuple[Array, Array]:
    """Fit smooth functions of the light to values at some lights.

    Photographs vary evenly with the angle of the light, but a material's splines are over (l_x, l_y). So thin plates
    [Duchon1977] are fitted over the angles, and a spline over (l_x, l_y) goes through their values at the lights and at
    up to `NODES` more directions.

    Parameters
    ----------
    lights : (m, 3) float
    values : (m, k) float
    smoothing
        Smoothing of the thin plates; 0 goes through the values. None takes `HARMONICS` harmonics instead.

    Returns
    -------
    nodes : (n, 2) float
        (l_x, l_y): the lights, then the other directions.
    weights : (n + 3, k) float
        Weights of the splines, as `kinran_bsdf.residual.Residual` keeps them.
    """
    if smoothing is None:
        return _of_harmonics(lights, values)
    spread = _spread(NODES, CROWDED, 0.5 * np.pi)
    at, other = plane(lights), plane(spread)
    distance = np.linalg.norm(other[:, None] - at[None], axis=-1).min(1)
    nodes = np.concatenate([lights, spread[distance > 0.4 * np.pi / NODES**0.5]])
    smooth = kernel_matrix(plane(nodes), at) @ spline(at, values, smoothing)
    return nodes[:, :2], spline(nodes, smooth, 0.0)


def _spread(count: int, exponent: float, most: float) -> Array:
    """Directions (count, 3) over the cap of θ up to `most` radians."""
    k = np.arange(count) + 0.5
    return frames.direction(most * (k / count) ** exponent, k * np.pi * (3 - 5**0.5))


def _of_harmonics(lights: Array, values: Array) -> tuple[Array, Array]:
    """Nodes and weights of `plates`, nearest to harmonics over the cap of the lights; beyond it these turn sharply."""
    basis = harmonics(HARMONICS)
    most = float(frames.angles(lights)[0].max())
    nodes = np.concatenate([lights, _spread(NODES, CROWDED, most)])
    dense = np.concatenate([lights, _spread(DENSE, 0.5, most)])
    B = basis(lights)
    normal = B.T @ B
    normal += RIDGE * np.trace(normal) / len(normal) * np.eye(len(normal))
    right = basis(dense) @ np.linalg.solve(normal, B.T @ values)
    weights = np.linalg.lstsq(kernel_matrix(dense[:, :2], nodes[:, :2]), right, rcond=NOISE)[0]
    return nodes[:, :2], np.asarray(weights, float)
