"""The flat field: the smooth fall of light over the picture by lens and lamp, for each direction of the light."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from kinran.data.radiance import HOT, Image, Radiance

Array = NDArray[np.float64]

DEGREE = 4
"""Degree of the surface: the light of a lens falls with the fourth power of the cosine of the field angle."""
PAIRS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i))
"""Degrees in y and x of the Legendre products."""
LEAST = 0.1
"""Least value of a flat field that is divided by: a sample that it would brighten more than tenfold is flagged as a
defect. No measurement stands behind it."""


@dataclass(frozen=True)
class Flat:
    """Light of a white plate relative to that in the middle of the picture.

    Attributes
    ----------
    theta, phi
        Direction of the lamp in degrees.
    coefficients : (3, 15)
        Legendre products of R, G, B up to degree 4 in x and y together; x runs from -1 to 1 over the columns, y over
        the rows from the bottom.
    """

    theta: float
    phi: float
    coefficients: tuple[tuple[float, ...], ...]

    def values(self, height: int, width: int, rows: slice = slice(None)) -> Image:
        """Return the flat field (height, width, 3), or the given rows of it."""
        along_y, along_x = (legendre.legvander(centres(n), DEGREE) for n in (height, width))
        grid = np.zeros((3, DEGREE + 1, DEGREE + 1))
        for pair, value in zip(PAIRS, np.transpose(self.coefficients), strict=True):
            grid[:, *pair] = value
        return np.asarray(np.stack([along_y[rows] @ part @ along_x.T for part in grid], -1), np.float32)


def nearest(flats: tuple[Flat, ...], theta: float, phi: float) -> Flat | None:
    """Return the flat field whose light direction is nearest to this one (degrees); None if there is none."""

    def between(flat: Flat) -> float:
        a, b = math.radians(flat.theta), math.radians(theta)
        turn = math.radians(flat.phi - phi)
        return -math.cos(a) * math.cos(b) - math.sin(a) * math.sin(b) * math.cos(turn)

    return min(flats, key=between, default=None)


def divide(picture: Radiance, flat: Image) -> Radiance:
    """Divide a picture (y, x, 3) by its flat field (y, x, 3).

    Where that is not finite or not over `LEAST`, the value is 0 and flagged as a defect.
    """
    good = np.isfinite(flat) & (flat > LEAST)
    value = np.where(good, picture.value / np.where(good, flat, 1), 0)
    return Radiance(value.astype(np.float32), picture.flags | np.where(good, 0, HOT).astype(np.uint8))


def centres(count: int) -> Array:
    """Return the places (count,) of texel centres along a side that runs from -1 to 1."""
    return (np.arange(count) + 0.5) / count * 2 - 1
