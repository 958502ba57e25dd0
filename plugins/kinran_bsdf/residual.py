"""The residual of the lobes: a few principal components over the lights, in display-like values.

Photographs under few lights show cast shadows, relief and a second gloss, which lobes cannot model. In display-like
values, compressed so that shadows count as much as highlights, a picture under the light l is

    s · compress(lobes) + R₀ + Σ_k b_k(l_x, l_y) R_k

with maps R and functions b of the light that are thin-plate splines through the fitted lights. The share s is 1
where the lobes are trusted, and 0 where plain interpolation does better.
"""

import json
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from kinran_bsdf.arrays import Array, Map

LOG_COMPRESSION = 500.0
"""Factor in ln(1 + 500 x / peak), the compression ``log:PEAK``: it bends at 1/500 of the peak. A choice, which the
chart's PSNR of radiance shares (docs/chart.md); no measurement stands behind it."""


@dataclass(frozen=True)
class Residual:
    """Dependence of a material's residual on the light; its maps are the channels ``residualK.RGB``.

    Attributes
    ----------
    domain
        Compression of the values: ``srgb``, ``linear``, ``gamma:EXPONENT`` or ``log:PEAK``.
    share
        Share s of the lobes in a picture, 0 to 1.
    lights : (n, 2) float
        (l_x, l_y) of the fitted lights.
    weights : (n + 3, count) float
        Spline coefficients of each component: kernels, then 1, l_x, l_y.
    """

    domain: str
    share: float
    lights: Array
    weights: Array

    @property
    def count(self) -> int:
        """Number of components besides the mean."""
        return self.weights.shape[1]

    def basis(self, lights: ArrayLike) -> Array:
        """Return the factors (m, count + 1) of the maps under lights (m, 3); the first, of the mean, is 1."""
        at = np.asarray(lights, float)[:, :2]
        splines = kernel_matrix(at, self.lights) @ self.weights
        return np.concatenate([np.ones((len(at), 1)), splines], 1)

    def to_json(self) -> str:
        """Return the text for the header of a material."""
        return json.dumps(
            {
                "domain": self.domain,
                "share": self.share,
                "lights": np.round(self.lights, 9).tolist(),
                "weights": [[float(f"{v:.9g}") for v in row] for row in self.weights],
            }
        )

    @classmethod
    def from_json(cls, text: str) -> "Residual":
        """Parse the text of a material's header.

        Raises
        ------
        ValueError, KeyError, TypeError
            The text does not describe a residual.
        """
        value = json.loads(text)
        lights = np.array(value["lights"], float).reshape(-1, 2)
        weights = np.array(value["weights"], float)
        if weights.ndim != 2 or len(weights) != len(lights) + 3:
            raise ValueError("the spline has another number of lights than of coefficients")
        compress(0.0, value["domain"])
        return cls(value["domain"], float(value["share"]), lights, weights)


def channel_names(count: int) -> list[str]:
    """Return the names of the channels of a residual's mean and of its `count` components."""
    return [f"residual{k}.{c}" for k in range(count + 1) for c in "RGB"]


def kernel_matrix(at: Array, lights: Array) -> Array:
    """Return the thin-plate basis (m, n + 3) at points (m, 2): kernels r² ln r around lights (n, 2), then 1, x, y."""
    square = ((at[:, None] - lights[None]) ** 2).sum(-1)
    kernels = np.where(square > 0, 0.5 * square * np.log(np.maximum(square, 1e-300)), 0)
    return np.concatenate([kernels, np.ones((len(at), 1)), at], 1)


def spline(lights: ArrayLike, values: Array, smoothing: float) -> Array:
    """Return the coefficients (n + 3, k) of smoothing thin-plate splines [Duchon1977, Wahba1990].

    Parameters
    ----------
    lights : (n, 2) or (n, 3) float
        Directions of the lights, of which (l_x, l_y) are used.
    values : (n, k) float
        Values at the lights.
    smoothing
        Smoothing parameter; with 0 the splines interpolate the values.
    """
    at = np.asarray(lights, float)[:, :2]
    n = len(at)
    system = np.zeros((n + 3, n + 3))
    system[:n] = kernel_matrix(at, at)
    system[:n, :n] += smoothing * np.eye(n)
    system[n:, :n] = system[:n, n:].T
    right = np.zeros((n + 3, values.shape[1]))
    right[:n] = values
    try:
        return np.asarray(np.linalg.solve(system, right))
    except np.linalg.LinAlgError:  # fewer than three lights, or all on a line
        return np.asarray(np.linalg.lstsq(system, right, rcond=None)[0])


def compress(light: Any, domain: str, *, xp: ModuleType = np) -> Any:
    """Return display-like values (...) of linear light (...), which may exceed 1; negative light counts as 0.

    Raises
    ------
    ValueError
        The domain is unknown.
    """
    x = xp.maximum(light, 0.0)
    kind, _, number = domain.partition(":")
    if kind == "linear":
        return x
    if kind == "gamma":
        return x ** (1 / float(number))
    if kind == "log":
        return xp.log(1 + x * (LOG_COMPRESSION / float(number))) * (1 / np.log1p(LOG_COMPRESSION))
    if kind == "srgb":
        choose = np.where if xp is np else xp.select
        return choose(x <= 0.0031308, 12.92 * x, 1.055 * xp.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055)
    raise ValueError(f"unknown domain '{domain}' of a residual")


def expand(value: Any, domain: str, *, xp: ModuleType = np) -> Any:
    """Return the linear light (...) of display-like values (...), as `compress` inverted; negative ones count as 0."""
    y = xp.maximum(value, 0.0)
    kind, _, number = domain.partition(":")
    if kind == "linear":
        return y
    if kind == "gamma":
        return y ** float(number)
    if kind == "log":
        return (xp.exp(y * np.log1p(LOG_COMPRESSION)) - 1) * (float(number) / LOG_COMPRESSION)
    if kind == "srgb":
        choose = np.where if xp is np else xp.select
        return choose(y <= 0.04045, y * (1 / 12.92), ((xp.maximum(y, 0.04045) + 0.055) * (1 / 1.055)) ** 2.4)
    raise ValueError(f"unknown domain '{domain}' of a residual")


def relit(lobes: Map, residual: Residual, maps: Map, factors: Array) -> Map:
    """Return a picture (…, 3) with the residual, which is never negative.

    Parameters
    ----------
    lobes : (…, 3) float32
        Picture of the lobes alone: π T in the stack's RGB.
    residual
        Dependence of the residual on the light.
    maps : (count + 1, …, 3) float32
        Mean and components of the residual.
    factors : (count + 1,)
        Factors of `Residual.basis` under the picture's light.
    """
    shown = np.float32(residual.share) * compress(lobes, residual.domain)
    shown = shown + np.tensordot(factors.astype(np.float32), maps, 1)
    return np.asarray(expand(shown, residual.domain), np.float32)
