"""What counts as the same θ_i and the same φ_i of lights."""

from collections.abc import Sequence

import numpy as np

from kinran.stack import Light

SCATTERED = float(np.radians(5)), float(np.radians(15))
"""Tolerances of lights on no grid: the paper's step in θ_i, and three of its steps in φ_i."""


def tolerances(lights: Sequence[Light]) -> tuple[float, float]:
    """Half a step of the grid in θ_i and φ_i, in radians; `SCATTERED` for lights on no grid."""
    grid = np.array([light.grid for light in lights if light.grid])
    if len(grid) < len(lights):
        return SCATTERED
    thetas = np.unique([round(float(np.degrees(np.arccos(light.direction[2]))), 3) for light in lights])
    azimuths = grid[:, 1].max() + 1
    return float(np.radians(0.5 * np.median(np.diff(thetas)))), float(1.02 * np.pi / azimuths)
