"""The model `takeda2008`: the paper's Eq. 3 to the letter."""

from types import ModuleType
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from kinran_bsdf.arrays import Map, Mask, mi
from kinran_bsdf.models.model import WIDTH_FLOOR, Model

NEWTON_STEPS = 8
"""Newton steps that invert the distribution of θ: 8 leave no bias in two million samples (Kolmogorov-Smirnov), 4 do in
wide lobes."""
ALMOST_ONE = 0.9999999
"""Largest argument of erfinv, which is infinite at 1: the second number below 1 in single precision, a choice."""


class Takeda2008(Model):
    """Takeda2008, Eq. 3: G = exp(−((θ_h − θ_n) / dt)² − ((φ_h − φ_n) / dp)²), at every view.

    The difference of azimuths is wrapped to [−π, π]: the paper does not say so, but without it a lobe at 350° is dark
    at 10°. All angles are in radians. Angles cannot be averaged, so that maps are looked up unfiltered.

    Attributes
    ----------
    theta, phi
        Parameters of a lobe: polar angles θ_n, φ_n of its facets.
    dt, dp
        Parameters of a lobe: widths in θ and φ.
    """

    name = "takeda2008"
    parameters: ClassVar = {"theta": 0.0, "phi": 0.0, "dt": 0.2, "dp": 0.5}
    counts = (1,)
    filtered = False
    lobes = 1

    @staticmethod
    def of_angles(theta_h: Any, phi_h: Any, theta: Any, phi: Any, dt: Any, dp: Any, *, xp: ModuleType = np) -> Any:
        """Return G at polar angles of the half vector, in radians."""
        turn = phi_h - phi
        turn = turn - 2 * np.pi * xp.round(turn / (2 * np.pi))
        a, b = (theta_h - theta) / dt, turn / dp
        return xp.exp(-a * a - b * b)

    def value(self, view: Any, light: Any, shape: Any, *, xp: ModuleType = np) -> Any:
        return self.of_angles(*half_angles(view, light, xp=xp), *shape, xp=xp)

    def albedo(self, shape: Any, *, xp: ModuleType = np) -> Any:
        """Return the approximate albedo, 2π dt dp sin 2θ_n away from the pole."""
        theta, _, dt, dp = shape
        sine = xp.maximum(xp.sin(theta), 0.5 * dt)
        return 4 * np.pi * dt * xp.minimum(dp, 2 * np.pi**0.5) * sine * xp.maximum(xp.cos(theta), 0.05)

    def integral(self, shape: Map, nodes: int) -> Map:
        """Return ∫ G 2 sin 2θ_h dθ_h dφ_h over θ_h < 45° (lights above the horizon), as a product of two integrals."""
        theta, _, dt, dp = shape
        low, high = np.clip(theta - 4 * dt, 0, np.pi / 4), np.clip(theta + 4 * dt, 0, np.pi / 4)
        reach = np.minimum(np.pi, 4 * dp)
        polar, azimuthal = np.zeros_like(theta), np.zeros_like(theta)
        for i in range(nodes):
            u = (i + 0.5) / nodes
            angle = low + (high - low) * u
            polar += np.exp(-(((angle - theta) / dt) ** 2)) * 2 * np.sin(2 * angle)
            azimuthal += np.exp(-((reach * u / dp) ** 2))
        return polar * (high - low) * azimuthal * 2 * reach * np.float32(1 / nodes**2)

    def without_width(self, shape: Any) -> Mask:
        _, _, dt, dp = shape
        return np.asarray((dt <= 0) | (dp <= 0))

    def floor_widths(self, shape: Map) -> None:
        np.maximum(shape[..., 2:], WIDTH_FLOOR, out=shape[..., 2:])

    def confined(self, shape: list[Any]) -> list[Any]:
        return shape[:2] + [dr.maximum(v, WIDTH_FLOOR) for v in shape[2:]]

    # The density in θ is ∝ θ exp(−((θ − m) / s)²) on [0, π/2]. Without the factor θ, the density in solid angle would
    # have a spike 1 / sin θ at the pole. With x = (θ − m) / s, the antiderivative is s times `_primitive`.

    def sample(self, shape: list[Any], u: Any) -> Any:
        theta, phi, dt, dp = shape
        low, high, start, end = _polar_range(theta, dt)
        target = dr.lerp(start, end, u.x)
        low, high = dr.maximum(low, -5.0), dr.minimum(high, 5.0)
        x = dr.erfinv(dr.clip(dr.lerp(dr.erf(low), dr.erf(high), u.x), -ALMOST_ONE, ALMOST_ONE))
        x = dr.clip(x, low, high)
        for _ in range(NEWTON_STEPS):
            error = _primitive(x, theta, dt) - target
            low = dr.select(error < 0, x, low)
            high = dr.select(error < 0, high, x)
            step = x - error / dr.maximum((theta + dt * x) * dr.exp(-x * x), 1e-12)
            # with strict comparisons the iteration oscillates
            x = dr.select((step >= low) & (step <= high), step, 0.5 * (low + high))
        polar = dr.clip(theta + dt * x, 0, 0.5 * dr.pi)
        spread = dr.clip((2 * u.y - 1) * dr.erf(dr.pi / dp), -ALMOST_ONE, ALMOST_ONE)
        st, ct = dr.sincos(polar)
        sp, cp = dr.sincos(phi + dp * dr.erfinv(spread))
        return mi.Vector3f(st * cp, st * sp, ct)

    def density(self, shape: list[Any], view: Any, light: Any) -> Any:
        theta, phi, dt, dp = shape
        x, y, z = view.x + light.x, view.y + light.y, view.z + light.z
        theta_h, phi_h = half_angles(view, light, xp=dr)
        _, _, start, end = _polar_range(theta, dt)
        norm = dt * (end - start) * dp * dr.sqrt(dr.pi) * dr.erf(dr.pi / dp)
        ratio = dr.select(theta_h > 1e-4, theta_h / dr.maximum(dr.sin(theta_h), 1e-5), 1)
        value = self.of_angles(theta_h, phi_h, theta, phi, dt, dp, xp=dr) * ratio
        density = dr.select(norm > 0, value / dr.maximum(norm, 1e-30), 0)
        return density / dr.maximum(2 * dr.sqrt(x * x + y * y + z * z), 1e-6)


def half_angles(view: Any, light: Any, *, xp: ModuleType = np) -> tuple[Any, Any]:
    """Return the polar angles (θ_h, φ_h), in radians, of the half vector of two unit vectors; φ_h = 0 at N."""
    x, y, z = view[0] + light[0], view[1] + light[1], view[2] + light[2]
    return xp.atan2(xp.sqrt(x * x + y * y), z), xp.atan2(y, x)


def _primitive(x: Any, m: Any, s: Any) -> Any:
    return 0.5 * dr.sqrt(dr.pi) * m * dr.erf(x) - 0.5 * s * dr.exp(-x * x)


def _polar_range(m: Any, s: Any) -> tuple[Any, Any, Any, Any]:
    low, high = -m / s, (0.5 * dr.pi - m) / s
    return low, high, _primitive(low, m, s), _primitive(high, m, s)
