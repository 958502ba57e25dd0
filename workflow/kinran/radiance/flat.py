"""The flat field: how lens and lamp light the picture, from a white plate; smooth, and for each light direction."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from kinran.stack import HOT, SATURATED

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]
Array = NDArray[np.float64]

DEGREE = 4
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

    def values(self, height: int, width: int) -> Image:
        """(height, width, 3)."""
        basis = _basis(height, width)
        planes = [(basis @ np.array(part)).reshape(height, width) for part in self.coefficients]
        return np.stack(planes, -1).astype(np.float32)


def fit_flat(rate: Image, flags: Flags, irradiance: Image, theta: float, phi: float) -> Flat:
    """Flat field of a merged white plate: a smooth surface, by least squares without dust and defects.

    Parameters
    ----------
    rate : (y, x, 3) float32
    flags : (y, x, 3) uint8
    irradiance : (y, x, 1) float32
        What the lamp's distance explains, which is no fault of the lens.
    theta, phi
        Direction of the lamp in degrees.
    """
    height, width = rate.shape[:2]
    basis = _basis(height, width)
    middle = _basis(1, 1)[0]
    coefficients = []
    for c in range(3):
        value = (rate[..., c] / irradiance[..., 0]).ravel().astype(float)
        use = (flags[..., c].ravel() & (SATURATED | HOT) == 0) & np.isfinite(value)
        solution = np.zeros(basis.shape[1])
        for _ in range(4):
            solution = np.linalg.lstsq(basis[use], value[use], rcond=None)[0]
            off = np.abs(value - basis @ solution)
            use &= off < 4 * 1.4826 * np.median(off[use]) + 1e-9
        coefficients.append(tuple(float(v) for v in solution / (middle @ solution)))
    return Flat(theta, phi, tuple(coefficients))


def nearest(flats: tuple[Flat, ...], theta: float, phi: float) -> Flat | None:
    """The flat field whose light comes from the direction nearest to this one (degrees); None if there are none."""

    def between(flat: Flat) -> float:
        a, b = math.radians(flat.theta), math.radians(theta)
        turn = math.radians(flat.phi - phi)
        return -math.cos(a) * math.cos(b) - math.sin(a) * math.sin(b) * math.cos(turn)

    return min(flats, key=between, default=None)


def divide(rate: Image, flags: Flags, flat: Image) -> tuple[Image, Flags]:
    """Picture (y, x, 3) over its flat field; where that is no number or too small, 0 and flagged as a defect."""
    good = np.isfinite(flat) & (flat > LEAST)
    value = np.where(good, rate / np.where(good, flat, 1), 0)
    return value.astype(np.float32), flags | np.where(good, 0, HOT).astype(np.uint8)


def _basis(height: int, width: int) -> Array:
    """(height · width, 15) Legendre products at the centres of texels."""
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in (height, width))
    powers_y, powers_x = legendre.legvander(y, DEGREE), legendre.legvander(x, DEGREE)
    pairs = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    return np.stack([np.outer(powers_y[:, i], powers_x[:, j]).ravel() for i, j in pairs], 1)
