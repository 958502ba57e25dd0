"""Encodings of linear light in image values: sRGB, a power law, or none.

The plugin, which is installed without this package, has the same curves for NumPy and Dr.Jit (`kinran_bsdf.residual`).
"""

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.files import InputError

Image = NDArray[np.float32]
Real = TypeVar("Real", np.float32, np.float64)

BLACK = 0.03
"""Linear light that `Encoding.weight` adds to each sample, since the curves' slopes grow without bound near black: else
a few dark samples would decide a fit. Its size is a choice; no measurement stands behind it."""


@dataclass(frozen=True)
class Encoding:
    """An encoding of linear light in [0, 1].

    Attributes
    ----------
    name
        ``srgb``, ``linear`` or ``gamma:EXPONENT``.
    exponent
        Exponent of the power law; 1 for linear, 0 for the sRGB curve.
    """

    name: str
    exponent: float

    def decode(self, values: ArrayLike) -> Image:
        """Return the linear light (...), float32, of encoded values (...) in [0, 1]."""
        v = np.asarray(values, np.float32)
        if self.exponent == 1:
            return v
        if self.exponent:
            return np.maximum(v, 0) ** np.float32(self.exponent)
        return from_srgb(v)

    def encode(self, light: ArrayLike) -> Image:
        """Return the encoded values (...), float32, of linear light (...), which is clipped to [0, 1]."""
        v = np.clip(np.asarray(light, np.float32), 0, 1)
        if self.exponent == 1:
            return v
        if self.exponent:
            return v ** np.float32(1 / self.exponent)
        return to_srgb(v)

    def weight(self, light: ArrayLike) -> Image:
        """Return the squared derivative of `encode` at linear light (...), softened near black by `BLACK`.

        With these weights, least squares in linear light is nearly least squares in encoded values.
        """
        v = np.asarray(light, np.float32)
        if self.exponent == 1:
            return np.ones_like(v)
        power = np.float32(2 * (1 / (self.exponent or 2.4) - 1))
        return (np.maximum(v, 0) + np.float32(BLACK)) ** power


def parse(name: str) -> Encoding:
    """Return the encoding that a name stands for.

    Raises
    ------
    InputError
        The name is not ``srgb``, ``linear`` or ``gamma:EXPONENT`` with an exponent from 0.2 to 5.
    """
    if name in ("srgb", "linear"):
        return Encoding(name, 0.0 if name == "srgb" else 1.0)
    kind, _, number = name.partition(":")
    try:
        exponent = float(number)
    except ValueError:
        exponent = 0.0
    if kind != "gamma" or not 0.2 <= exponent <= 5:
        raise InputError(f"encoding '{name}': give srgb, linear or gamma:EXPONENT, such as gamma:2.2")
    return Encoding(name, exponent)


def to_srgb(light: NDArray[Real]) -> NDArray[Real]:
    """Return sRGB values (...) of non-negative linear light (...), in its own precision (IEC 61966-2-1)."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def from_srgb(values: NDArray[Real]) -> NDArray[Real]:
    """Return the linear light (...) of sRGB values (...), in their own precision (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0) + 0.055) / 1.055) ** 2.4)
