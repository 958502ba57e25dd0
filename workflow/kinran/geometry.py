"""Where lamp and camera stand, and what follows for each texel: direction, falloff, view."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def texel_points(height: int, width: int, texel_mm: float) -> Array:
    """Centres (y, x, 3) of texels in millimetres from the field's centre, on the plane of the fabric."""
    x = (np.arange(width) + 0.5 - width / 2) * texel_mm
    y = (np.arange(height) + 0.5 - height / 2) * texel_mm
    return np.stack(np.broadcast_arrays(x, y[:, None], 0.0), -1)


def directions_to(position_mm: ArrayLike, points: Array) -> Array:
    """Unit vectors (..., 3) from points to a lamp or a camera."""
    towards = np.asarray(position_mm, float) - points
    return np.asarray(towards / np.linalg.norm(towards, axis=-1, keepdims=True))


def falloff(position_mm: ArrayLike, points: Array) -> Array:
    """Light (...) of a point lamp that reaches points square on, relative to the field's centre (inverse square).

    The stack's values hold it: radiance under the lamp as it stands, over that of a white diffuser in the middle.
    π·T of a texel is its value over this, and T includes the cosine of the texel's own θ_i.
    """
    position = np.asarray(position_mm, float)
    return np.asarray(np.square(position).sum(-1) / np.square(position - points).sum(-1))


def half_vectors(light: Array, view: Array) -> Array:
    """Unit vectors (..., 3) half way between unit vectors."""
    between = light + view
    return np.asarray(between / np.linalg.norm(between, axis=-1, keepdims=True))
