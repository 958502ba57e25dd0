"""Linear bases over the light direction: Lambert, polynomial texture maps, hemispherical harmonics."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import lpmv

Samples = NDArray[np.float32]
Array = NDArray[np.float64]
Basis = Callable[[Array], Array]


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
    values: Samples
    shared: int = 0

    @property
    def numbers(self) -> int:
        """Numbers of a texel."""
        return int(3 * self.values.shape[2])


def fit(T: Samples, lights: Array, basis: Basis, ridge: float = 0.0) -> Weights:
    """Least squares of the samples over a basis.

    Parameters
    ----------
    T : (texel, 3, light) float32
    lights : (light, 3) float
    basis
        `lambert`, `polynomial` or `harmonics(m)`.
    ridge
        Share of the mean of the normal matrix's diagonal that is added to it.
    """
    B = basis(lights)
    normal = B.T @ B
    normal += ridge * np.trace(normal) / len(normal) * np.eye(len(normal))
    solve = np.linalg.lstsq(normal, B.T, rcond=1e-12)[0].astype(np.float32)
    values = T.reshape(-1, T.shape[2]) @ solve.T
    return Weights(basis, values.reshape(len(T), 3, -1))


def predict(fitted: Weights, lights: Array) -> Samples:
    """Samples (texel, 3, light) under other lights."""
    return np.asarray(fitted.values @ fitted.basis(lights).T.astype(np.float32))


def lambert(lights: Array) -> Array:
    """Cosine of the light, (light, 1)."""
    return lights[:, 2:3]


def polynomial(lights: Array) -> Array:
    """Biquadratic of a polynomial texture map (Malzbender2001, Eq. 2): 1, x, y, x², y², xy; (light, 6)."""
    x, y = lights[:, 0], lights[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, y * y, x * y], 1)


def harmonics(count: int) -> Basis:
    """The first `count` hemispherical harmonics (Gautron2004), orthonormal over the hemisphere; (light, count).

    H_lm = K_lm P_lm(2 cos θ - 1) with √2 cos mφ or √2 sin |m|φ, and K² = (2l + 1) / 2π · (l - |m|)! / (l + |m|)!.
    """
    orders = [(l, m) for l in range(math.isqrt(count - 1) + 1) for m in range(-l, l + 1)][:count]  # noqa: E741

    def values(lights: Array) -> Array:
        z, phi = 2 * lights[:, 2] - 1, np.arctan2(lights[:, 1], lights[:, 0])
        columns = []
        for l, m in orders:  # noqa: E741 (the field's letter)
            a = abs(m)
            scale = math.sqrt((2 * l + 1) / (2 * math.pi) * math.factorial(l - a) / math.factorial(l + a))
            turn = np.cos(m * phi) if m >= 0 else np.sin(-m * phi)
            columns.append(scale * (math.sqrt(2) if m else 1.0) * lpmv(a, l, z) * turn)
        return np.stack(columns, 1)

    return values
