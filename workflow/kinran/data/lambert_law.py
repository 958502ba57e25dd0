"""Lambert's law: light that a texel sends back grows with the cosine at its normal, b · l."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROUNDS = 10
"""Rounds of reweighting. A choice."""
LEAST = 0.003
"""Residual in values that every residual counts for at least in the weights: that of 8 bits, rounded up."""
STEEPEST = 1e-3
"""Light at which the slope of an encoding is taken for darker values, since it grows without bound: a choice."""


def solve(weight: Array, y: Array, lights: Array) -> Array:
    """Solve weighted least squares of light y (texel, light) over directions (light, 3); (texel, 3)."""
    products = (lights[:, :, None] * lights[:, None]).reshape(len(lights), 9)
    normal = (weight @ products).reshape(-1, 3, 3)
    normal += (1e-9 * np.trace(normal, axis1=1, axis2=2) + 1e-30)[:, None, None] * np.eye(3)
    return np.asarray(np.linalg.solve(normal, ((weight * y) @ lights)[..., None])[..., 0])


def fit_codes(codes: Array, use: Array, lights: Array, exponent: float) -> tuple[Array, Array]:
    """Fit Lambert's law to values that encode light by a power law, with the least absolute residuals of the values.

    Parameters
    ----------
    codes : (texel, light) float
        Encoded values, 1 for white.
    use : (texel, light) float
        1 for values that count, 0 for others.
    lights : (light, 3) float
        Unit vectors to the lights, times the light of each lamp.
    exponent
        Exponent that makes light of values.

    Returns
    -------
    scaled : (texel, 3) float
        Normals times albedos.
    predicted : (texel, light) float
        Values that the law predicts; 0 where a texel turns away from the light.
    """
    light = np.maximum(codes, 0) ** exponent
    scaled = solve(use, light, lights)
    for _ in range(ROUNDS):
        seen = np.maximum(scaled @ lights.T, 0)
        slope = np.maximum((seen + light) / 2, STEEPEST) ** (1 / exponent - 1) / exponent
        off = np.maximum(np.abs(codes - seen ** (1 / exponent)), LEAST)
        scaled = solve(use * ((seen > 0) * slope / off + 1e-9), light, lights)
    return scaled, np.maximum(scaled @ lights.T, 0) ** (1 / exponent)
