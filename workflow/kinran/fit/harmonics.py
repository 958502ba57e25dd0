"""Hemispherical harmonics."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def harmonics(count: int) -> Callable[[Array], Array]:
    """The first `count` hemispherical harmonics (Gautron2004), orthonormal over the hemisphere.

    H_lm = K_lm P_lm(2 cos θ - 1) with √2 cos mφ or √2 sin |m|φ, and K² = (2l + 1) / 2π · (l - |m|)! / (l + |m|)!.

    Returns
    -------
    function
        From directions (light, 3) to values (light, count).
    """
    orders = [(l, m) for l in range(math.isqrt(count - 1) + 1) for m in range(-l, l + 1)][:count]  # noqa: E741

    def values(lights: Array) -> Array:
        from scipy.special import lpmv

        z, phi = 2 * lights[:, 2] - 1, np.arctan2(lights[:, 1], lights[:, 0])
        columns = []
        for l, m in orders:  # noqa: E741 (the field's letter)
            a = abs(m)
            scale = math.sqrt((2 * l + 1) / (2 * math.pi) * math.factorial(l - a) / math.factorial(l + a))
            turn = np.cos(m * phi) if m >= 0 else np.sin(-m * phi)
            columns.append(scale * (math.sqrt(2) if m else 1.0) * lpmv(a, l, z) * turn)
        return np.stack(columns, 1)

    return values
