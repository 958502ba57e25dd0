"""The flat field of a merged white plate: a smooth surface that ignores dust and defects."""

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from kinran.data.flat_field import DEGREE, PAIRS, Flat, centres
from kinran.data.radiance import HOT, SATURATED, Image, Radiance

Array = NDArray[np.float64]

MOST_TEXELS = 100_000
"""Most texels that the 15 coefficients are fitted to: noise of 1 % becomes 0.01 %."""


def fit_flat(plate: Radiance, irradiance: Image, theta: float, phi: float) -> Flat:
    """Fit the flat field of a merged white plate: a smooth surface, by least squares without dust and defects.

    Parameters
    ----------
    plate : (y, x, 3)
        The merged white plate.
    irradiance : (y, x, 1) float32
        Irradiance that the lamp's distance explains, which is not part of the flat field.
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


def _basis(height: int, width: int, step: int = 1) -> Array:
    """Return the Legendre products (rows · columns, 15) at the centres of every `step`-th texel along each side."""
    y, x = (legendre.legvander(centres(n)[::step], DEGREE) for n in (height, width))
    return np.stack([np.outer(y[:, i], x[:, j]).ravel() for i, j in PAIRS], 1)
