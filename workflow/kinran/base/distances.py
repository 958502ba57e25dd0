"""Positions of lamp and camera, and the light direction, falloff and view that each texel gets from them."""

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
        Millimetres that a length of 1 in the `.lp` stands for: the dome's radius where the vectors have that length, 1
        where they are positions in millimetres. None where they are directions, whatever their length.
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
    """Check the distances that are known.

    Raises
    ------
    InputError
        A distance is not a finite length over 0.
    """
    for name, value in asdict(distances).items():
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"--{name.replace('_', '-')} {value:g}: give a length over 0 mm")


def crop_centre(crop: tuple[int, int, int, int], size: tuple[int, int], field_mm: float) -> tuple[float, float]:
    """Return the middle (X, Y) of a crop, in millimetres from the middle of the photograph.

    Parameters
    ----------
    crop
        x, y, width and height in pixels from the top left.
    size
        Width and height of the photograph in pixels.
    field_mm
        Width of the photograph on the fabric.
    """
    x, y, width, height = crop
    pixel = field_mm / size[0]
    return (x + width / 2 - size[0] / 2) * pixel, (size[1] / 2 - y - height / 2) * pixel


def seen_from(position_mm: Vector, centre_mm: tuple[float, float]) -> Vector:
    """Return the position of a lamp or a camera, in millimetres, relative to a point (X, Y) of the fabric."""
    return position_mm[0] - centre_mm[0], position_mm[1] - centre_mm[1], position_mm[2]


def relative_light(positions_mm: ArrayLike) -> Array:
    """Return the irradiance (lamp,) of equal lamps at positions (lamp, 3) in mm at the field's centre, square on.

    It falls with the square of the distance, and is 1 at the lamps' median distance.
    """
    distance = np.linalg.norm(np.asarray(positions_mm, float), axis=1)
    return np.asarray((np.median(distance) / distance) ** 2)


def unit(vector: Vector) -> Vector:
    """Return the vector scaled to length 1."""
    length = math.hypot(*vector)
    return vector[0] / length, vector[1] / length, vector[2] / length


def texel_points(height: int, width: int, texel_mm: float) -> Array:
    """Return the centres (y, x, 3) of texels on the plane of the fabric, in millimetres from the field's centre."""
    x = (np.arange(width) + 0.5 - width / 2) * texel_mm
    y = (np.arange(height) + 0.5 - height / 2) * texel_mm
    return np.stack(np.broadcast_arrays(x, y[:, None], 0.0), -1)


def directions_to(position_mm: ArrayLike, points: Array) -> Array:
    """Return unit vectors (..., 3) from points (..., 3) to a lamp or a camera, all in millimetres."""
    towards = np.asarray(position_mm, float) - points
    return np.asarray(towards / np.linalg.norm(towards, axis=-1, keepdims=True))


def falloff(positions_mm: ArrayLike, points: Array) -> Array:
    """Return the irradiance of point lamps at points of planes that face them, relative to that at the field's centre.

    It falls with the square of the distance. A stack's values include it: they are radiance under the lamp as it
    stands, over that of a white diffuser in the middle. A texel's π·T is its value divided by this factor; T includes
    the cosine of the texel's own θ_i.

    Parameters
    ----------
    positions_mm : (..., 3)
        Positions of one lamp, or of several, in millimetres.
    points : (..., 3)
        Points in millimetres.

    Returns
    -------
    (lamps..., points...) float
    """
    positions = np.asarray(positions_mm, float)
    own = np.square(positions).sum(-1).reshape(positions.shape[:-1] + (1,) * (points.ndim - 1))
    return np.asarray(own / (own - 2 * np.tensordot(positions, points, (-1, -1)) + np.square(points).sum(-1)))
