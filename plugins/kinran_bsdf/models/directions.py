"""What the models share: half vectors, and how far from the measured view data speak.

Directions are triples of NumPy or of Dr.Jit arrays, in the frame of the fabric: X weft, Y warp, Z normal.
"""

from types import ModuleType
from typing import Any

import numpy as np

GRAZING = float(np.cos(np.radians(85.0)))
"""Cosine from which T fades to the horizon: the paper's grid of lights ends at 80°."""


def half_slopes(view: Any, light: Any) -> tuple[Any, Any]:
    """Slopes (h_x / h_z, h_y / h_z) of the half vector of two unit vectors, given as triples."""
    z = view[2] + light[2]
    return (view[0] + light[0]) / z, (view[1] + light[1]) / z


def half_angles(view: Any, light: Any, *, xp: ModuleType = np) -> tuple[Any, Any]:
    """Polar angles (θ_h, φ_h) of the half vector of two unit vectors, given as triples; φ_h = 0 at N."""
    x, y, z = view[0] + light[0], view[1] + light[1], view[2] + light[2]
    return xp.atan2(xp.sqrt(x * x + y * y), z), xp.atan2(y, x)


def release(view: Any, light: Any, *, xp: ModuleType = np) -> Any:
    """1 where view or light is N, falling to 0.32 at 30° and 0.004 at 60°: how far data speak there."""
    c = xp.maximum(view[2], light[2])
    c = c * c
    c = c * c
    return c * c


def grazing(theta_max: float) -> float:
    """Cosine from which T fades to the horizon: of 85°, or of the lowest measured light if that is lower."""
    return float(min(GRAZING, max(np.cos(theta_max), 1e-3)))
