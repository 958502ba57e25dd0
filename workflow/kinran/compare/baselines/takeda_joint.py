"""Eq. 3 of Takeda2008 fitted jointly, by non-linear least squares over all samples."""

from functools import partial

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.compare.baselines import separable
from kinran.compare.baselines.separable import SeparableFit
from kinran.fit.samples import Samples
from kinran.fit.takeda import FLAT, TakedaFit

Array = NDArray[np.float64]

LOW, HIGH = np.array([-0.2, -1e3, np.log(0.01), np.log(0.02)]), np.array([1.2, 1e3, np.log(3.0), np.log(FLAT)])
"""Bounds of θ_n, φ_n, log dt and log dp: those of the four steps, with room for a search to turn back."""


def fit(samples: Samples, start: TakedaFit, wrap: bool = True) -> SeparableFit:
    """Fit Eq. 3 to all samples; the four steps use only a few of them.

    Parameters
    ----------
    start
        Fit of the four steps, whose shapes the search starts from.
    wrap
        Whether φ_h − φ_n is wrapped to [−π, π]; the formula as printed does not say so.
    """
    first = np.concatenate([start.shapes[:, :2], np.log(start.shapes[:, 2:])], 1)
    return separable.fit(partial(lobe, wrap=wrap), first[:, None], samples, LOW, HIGH)


def lobe(p: Array, slopes: Array, _lights: Array, wrap: bool = True) -> tuple[Array, Array]:
    """Values (n, light) of shapes θ_n, φ_n, log dt, log dp (n, 4), and their derivatives (n, 4, light)."""
    theta, phi = frames.angles(np.concatenate([slopes, np.ones((len(slopes), 1))], 1))
    theta_n, phi_n, dt, dp = p[:, :1], p[:, 1:2], np.exp(p[:, 2:3]), np.exp(p[:, 3:])
    turn = frames.wrap(phi - phi_n) if wrap else phi - phi_n
    a, b = (theta - theta_n) / dt, turn / dp
    G = np.exp(-a * a - b * b)
    return G, 2 * G[:, None] * np.stack([a / dt, b / dp, a * a, b * b], 1)
