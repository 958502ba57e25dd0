"""Where lamp and camera stand, and what follows for each texel: direction, falloff, view."""

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.files import InputError

Array = NDArray[np.float64]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Distances:
    """Distances of a set of photographs in millimetres; None for those that were not measured.

    Attributes
    ----------
    lamp_mm
        Millimetres of a length of 1 in the `.lp`: the dome's radius where its vectors have that length, 1 where they
        are positions in millimetres. Without it they are directions, whatever their length.
    field_mm
        Width of a whole photograph on the fabric.
    camera_mm
        Distance of the camera's centre of projection from the fabric.
    """

    lamp_mm: float | None = None
    field_mm: float | None = None
    camera_mm: float | None = None


UNKNOWN = Distances()
"""Distances of a set where none was measured."""


def check_lengths(distances: Distances) -> None:
    """Check what somebody measured.

    Raises
    ------
    InputError
        One is no length.
    """
    for name, value in asdict(distances).items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a length over 0 mm")


def crop_centre(crop: tuple[int, int, int, int], size: tuple[int, int], field_mm: float) -> tuple[float, float]:
    """X and Y in millimetres of the middle of a crop (x, y, width, height from the top left) in a photograph."""
    x, y, width, height = crop
    pixel = field_mm / size[0]
    return (x + width / 2 - size[0] / 2) * pixel, (size[1] / 2 - y - height / 2) * pixel


def seen_from(position_mm: Vector, centre_mm: tuple[float, float]) -> Vector:
    """Position of a lamp or a camera from another point (X, Y) of the fabric."""
    return position_mm[0] - centre_mm[0], position_mm[1] - centre_mm[1], position_mm[2]


def relative_light(positions_mm: ArrayLike) -> Array:
    """Light (lamp,) that equal lamps at positions (lamp, 3) bring to the field's centre, square on; its middle is 1."""
    distance = np.linalg.norm(np.asarray(positions_mm, float), axis=1)
    return np.asarray((np.median(distance) / distance) ** 2)


def unit(vector: Vector) -> Vector:
    """Vector of length 1."""
    length = math.hypot(*vector)
    return vector[0] / length, vector[1] / length, vector[2] / length


def texel_points(height: int, width: int, texel_mm: float) -> Array:
    """Centres (y, x, 3) of texels in millimetres from the field's centre, on the plane of the fabric."""
    x = (np.arange(width) + 0.5 - width / 2) * texel_mm
    y = (np.arange(height) + 0.5 - height / 2) * texel_mm
    return np.stack(np.broadcast_arrays(x, y[:, None], 0.0), -1)


def directions_to(position_mm: ArrayLike, points: Array) -> Array:
    """Unit vectors (..., 3) from points to a lamp or a camera."""
    towards = np.asarray(position_mm, float) - points
    return np.asarray(towards / np.linalg.norm(towards, axis=-1, keepdims=True))


def falloff(positions_mm: ArrayLike, points: Array) -> Array:
    """Light of point lamps that reaches points square on, relative to the field's centre (inverse square).

    The stack's values hold it: radiance under the lamp as it stands, over that of a white diffuser in the middle.
    π·T of a texel is its value over this, and T includes the cosine of the texel's own θ_i.

    Parameters
    ----------
    positions_mm : (..., 3)
        Positions of one lamp, or of several, in millimetres.
    points : (..., 3)

    Returns
    -------
    (lamps..., points...) float
    """
    positions = np.asarray(positions_mm, float)
    own = np.square(positions).sum(-1).reshape(positions.shape[:-1] + (1,) * (points.ndim - 1))
    return np.asarray(own / (own - 2 * np.tensordot(positions, points, (-1, -1)) + np.square(points).sum(-1)))
