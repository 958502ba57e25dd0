"""The flat field: how lens and lamp light the picture, from a white plate; smooth, and for each light direction."""

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
"""Degrees in y and x of the products."""
LEAST = 0.1
"""A flat field under this is no measurement: what it would brighten so much is flagged as a defect."""


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
        """(height, width, 3), or some rows of it."""
        along_y, along_x = (legendre.legvander(centres(n), DEGREE) for n in (height, width))
        grid = np.zeros((3, DEGREE + 1, DEGREE + 1))
        for pair, value in zip(PAIRS, np.transpose(self.coefficients), strict=True):
            grid[:, *pair] = value
        return np.asarray(np.stack([along_y[rows] @ part @ along_x.T for part in grid], -1), np.float32)


def nearest(flats: tuple[Flat, ...], theta: float, phi: float) -> Flat | None:
    """The flat field whose light comes from the direction nearest to this one (degrees); None if there are none."""

    def between(flat: Flat) -> float:
        a, b = math.radians(flat.theta), math.radians(theta)
        turn = math.radians(flat.phi - phi)
        return -math.cos(a) * math.cos(b) - math.sin(a) * math.sin(b) * math.cos(turn)

    return min(flats, key=between, default=None)


def divide(picture: Radiance, flat: Image) -> Radiance:
    """Picture (y, x, 3) over its flat field; where that is no number or too small, 0 and flagged as a defect."""
    good = np.isfinite(flat) & (flat > LEAST)
    value = np.where(good, picture.value / np.where(good, flat, 1), 0)
    return Radiance(value.astype(np.float32), picture.flags | np.where(good, 0, HOT).astype(np.uint8))


def centres(count: int) -> Array:
    """(count,) places of texels, from -1 to 1."""
    return (np.arange(count) + 0.5) / count * 2 - 1
