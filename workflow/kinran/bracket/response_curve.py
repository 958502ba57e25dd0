"""Debevec and Malik's radiance from photographs (Debevec1997): a camera's response curve, and the mean of logarithms.

It is a baseline. Its curve also linearises gamma-encoded photographs of an unknown camera.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Image = NDArray[np.float32]

CODES = 256
"""Number of codes of 8 bits."""
SMOOTHNESS = 30.0
"""Smoothness λ of Debevec1997, Eq. 3, which the paper leaves to the noise of the data: a choice."""
SAMPLES = 400
"""Sites that the curve is recovered from: with N sites and P exposures Debevec1997 ask for N (P - 1) over 255."""


@dataclass(frozen=True)
class Curve:
    """A recovered response curve.

    Attributes
    ----------
    light : (256,)
        Linear light of each code of 8 bits; that of the last is 1.
    """

    light: tuple[float, ...]

    def decode(self, values: ArrayLike) -> Image:
        """Return the linear light (...), float32, of encoded values (...) in [0, 1]."""
        at = np.clip(np.asarray(values, float), 0, 1) * (CODES - 1)
        return np.asarray(np.interp(at, np.arange(CODES), self.light), np.float32)


def recover(codes: NDArray[np.uint8], seconds: Array) -> Curve:
    """Recover the response curve of a bracket (Debevec1997, Eq. 3) from sites of all levels.

    Parameters
    ----------
    codes : (exposure, site) uint8
        Codes of the sites.
    seconds : (exposure,) float
        Exposure times in seconds.
    """
    chosen = _spread(codes)
    z = codes[:, chosen].astype(int)
    exposures, sites = z.shape
    smooth = CODES - 2
    A, b = np.zeros((exposures * sites + smooth + 1, CODES + sites)), np.zeros(exposures * sites + smooth + 1)
    w = hat(z)
    row = np.arange(exposures * sites)
    A[row, z.ravel()] = w.ravel()
    A[row, CODES + np.tile(np.arange(sites), exposures)] = -w.ravel()
    b[: len(row)] = (w * np.log(seconds)[:, None]).ravel()
    A[len(row), CODES // 2] = 1
    inner = np.arange(1, CODES - 1)
    at = len(row) + inner
    for shift, factor in ((-1, 1), (0, -2), (1, 1)):
        A[at, inner + shift] = factor * SMOOTHNESS * hat(inner)
    # normal equations: sparse rows, and smoothness ties codes that no site has
    g = np.linalg.solve(A.T @ A + 1e-9 * np.eye(A.shape[1]), A.T @ b)[:CODES]
    light = np.maximum.accumulate(np.exp(g - g[-1]))
    light[0] = 0
    return Curve(tuple(float(value) for value in light))


def hat(codes: ArrayLike) -> Array:
    """Return the weights of codes: 0 at both ends, highest in the middle (Debevec1997, Eq. 4)."""
    z = np.asarray(codes, float)
    return np.asarray(np.minimum(z, CODES - 1 - z) / (CODES / 2))


def merge_debevec(codes: NDArray[np.uint8], seconds: Array, curve: Curve) -> Image:
    """Return the radiance (...) of codes (exposure, ...), the weighted mean of logarithms (Debevec1997, Eq. 6).

    It is NaN where every weight is 0.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        g = np.log(np.asarray(curve.light))
        w = hat(codes)
        shape = (-1, *[1] * (codes.ndim - 1))
        logs = np.where(w > 0, g[codes] - np.log(seconds).reshape(shape), 0)
        return np.asarray(np.exp((w * logs).sum(0) / w.sum(0)), np.float32)


def _spread(codes: NDArray[np.uint8]) -> NDArray[np.intp]:
    """Return the indices of sites whose median codes are spread evenly over all that occur."""
    order = np.argsort(np.sort(codes, axis=0)[len(codes) // 2], kind="stable")
    return np.asarray(order[np.linspace(0, len(order) - 1, min(SAMPLES, len(order))).round().astype(int)])
