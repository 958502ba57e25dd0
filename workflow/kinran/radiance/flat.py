"""The flat field: how lens and lamp light the picture, from a white plate; smooth, and for each light direction."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from kinran.radiance.value import HOT, SATURATED, Image, Radiance

Array = NDArray[np.float64]

DEGREE = 4
"""Degree of the surface: the light of a lens falls with the fourth power of the cosine of the field angle."""
PAIRS = tuple((i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i))
"""Degrees in y and x of the products."""
MOST_TEXELS = 100_000
"""Enough to fit 15 coefficients to: noise of 1 % is 0.01 % then."""
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
        along_y, along_x = (legendre.legvander(_centres(n), DEGREE) for n in (height, width))
        grid = np.zeros((3, DEGREE + 1, DEGREE + 1))
        for pair, value in zip(PAIRS, np.transpose(self.coefficients), strict=True):
            grid[:, *pair] = value
        return np.asarray(np.stack([along_y[rows] @ part @ along_x.T for part in grid], -1), np.float32)


def fit_flat(plate: Radiance, irradiance: Image, theta: float, phi: float) -> Flat:
    """Flat field of a merged white plate: a smooth surface, by least squares without dust and defects.

    Parameters
    ----------
    plate : (y, x, 3)
        The merged white plate.
    irradiance : (y, x, 1) float32
        What the lamp's distance explains, which is no fault of the lens.
    theta, phi
        Direction of the lamp in degrees.
    """
    height, width = plate.value.shape[:2]
    step = max(1, round((height * width / MOST_TEXELS) ** 0.5))
    some, far = plate[::step, ::step], irradiance[::step, ::step, 0]
    sound = ~some.has(SATURATED | HOT)
    basis = _basis(height, width, step)
    middle = _basis(1, 1)[0]
    coefficients = []
    for c in range(3):
        value = (some.value[..., c] / far).ravel().astype(float)
        use = sound[..., c].ravel() & np.isfinite(value)
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


def divide(picture: Radiance, flat: Image) -> Radiance:
    """Picture (y, x, 3) over its flat field; where that is no number or too small, 0 and flagged as a defect."""
    good = np.isfinite(flat) & (flat > LEAST)
    value = np.where(good, picture.value / np.where(good, flat, 1), 0)
    return Radiance(value.astype(np.float32), picture.flags | np.where(good, 0, HOT).astype(np.uint8))


def _basis(height: int, width: int, step: int = 1) -> Array:
    """(rows · columns, 15) Legendre products at the centres of texels, or of every so many."""
    y, x = (legendre.legvander(_centres(n)[::step], DEGREE) for n in (height, width))
    return np.stack([np.outer(y[:, i], x[:, j]).ravel() for i, j in PAIRS], 1)


def _centres(count: int) -> Array:
    """(count,) places of texels, from -1 to 1."""
    return (np.arange(count) + 0.5) / count * 2 - 1
