"""How image values encode linear light: sRGB, a power, or not at all."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.files import InputError

Image = NDArray[np.float32]


@dataclass(frozen=True)
class Encoding:
    """An encoding of linear light in [0, 1].

    Attributes
    ----------
    name
        ``srgb``, ``linear`` or ``gamma:EXPONENT``.
    exponent
        Of the power law; 1 for linear, 0 for the sRGB curve.
    """

    name: str
    exponent: float

    def decode(self, values: ArrayLike) -> Image:
        """Linear light of encoded values in [0, 1], float32 (IEC 61966-2-1 for sRGB)."""
        v = np.asarray(values, np.float32)
        if self.exponent == 1:
            return v
        if self.exponent:
            return np.maximum(v, 0) ** np.float32(self.exponent)
        return np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0) + 0.055) / 1.055) ** 2.4).astype(np.float32)

    def encode(self, light: ArrayLike) -> Image:
        """Encoded values in [0, 1] of linear light, which is clipped to [0, 1]; float32."""
        v = np.clip(np.asarray(light, np.float32), 0, 1)
        if self.exponent == 1:
            return v
        if self.exponent:
            return v ** np.float32(1 / self.exponent)
        return np.where(v <= 0.0031308, 12.92 * v, 1.055 * v ** np.float32(1 / 2.4) - 0.055).astype(np.float32)

    def weight(self, light: ArrayLike) -> Image:
        """Squared derivative of `encode`, softened near black: least squares then means encoded values."""
        v = np.asarray(light, np.float32)
        if self.exponent == 1:
            return np.ones_like(v)
        power = np.float32(2 * (1 / (self.exponent or 2.4) - 1))
        return (np.maximum(v, 0) + np.float32(0.03)) ** power


def parse(name: str) -> Encoding:
    """Encoding of a name.

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
