"""Linear bases over the light direction: polynomial texture maps, hemispherical harmonics."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Basis = Callable[[Array], Array]

RIDGE = 1e-6
"""Ridge of harmonics, over the mean of the normal matrix's diagonal: few lights leave some harmonics undetermined. A
choice: with less, 16 of them under 16 lights explode."""


@dataclass(frozen=True)
class Weights:
    """Weights of a basis.

    Attributes
    ----------
    basis
        Function from directions (light, 3) to values (light, m).
    values : (texel, 3, m) float32
    """

    basis: Basis
    values: Single
    shared: int = 0

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return float(3 * self.values.shape[2])

    def predict(self, under: Under) -> Single:
        """Values (texel, 3, light) under some lights, of the kind that was fitted."""
        out = np.empty((len(self.values), 3, under.count), np.float32)
        for k, at in under.cells():
            out[at] = self.values[at] @ self.basis(under.lights[k]).T.astype(np.float32)
        return out


def fit(samples: Samples, basis: Basis, ridge: float = 0.0) -> Weights:
    """Fit a basis to the samples by least squares, in which all samples count alike.

    Parameters
    ----------
    basis
        `polynomial` or `kinran.fit.harmonics.harmonics(m)`.
    ridge
        Ridge, over the mean of the normal matrix's diagonal.
    """
    values = np.empty((*samples.T.shape[:2], basis(samples.under.directions).shape[1]), np.float32)
    for k, at in samples.under.cells():
        B = basis(samples.under.lights[k])
        normal = B.T @ B
        normal += ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
        solve = np.linalg.lstsq(normal, B.T, rcond=1e-12)[0].astype(np.float32)
        values[at] = samples.T[at] @ solve.T
    return Weights(basis, values)


def polynomial(lights: Array) -> Array:
    """Biquadratic of a polynomial texture map (Malzbender2001, Eq. 2): 1, x, y, x², y², xy; (light, 6)."""
    x, y = lights[:, 0], lights[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], 1)
