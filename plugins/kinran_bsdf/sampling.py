"""Sampling of the lobes: for each model one density of light directions and the sampler that has it.

A sampler draws a half vector h; reflecting the view about it gives the light, whose density in solid angle is
p(h) / (4 v·h). These run on Dr.Jit arrays only.
"""

from typing import Any

import drjit as dr
import mitsuba

from kinran_bsdf import models

mi: Any = mitsuba  # its types are those of the variant, at run time

NEWTON_STEPS = 8  # with 4 wide lobes come out biased
ALMOST_ONE = 0.9999999


def energy(model: str, shape: list[Any]) -> Any:
    """Albedo at V = N of a lobe of amplitude 1, approximately: its weight in the mixture."""
    if model == "takeda2008":
        return models.takeda_albedo(shape[0], shape[2], shape[3], xp=dr)
    return models.slope_albedo(*shape, xp=dr)


def sample_half_vector(model: str, tail: str, shape: list[Any], u: Any) -> Any:
    """Half vector drawn from a lobe with two uniform numbers `u`."""
    if model == "takeda2008":
        return _sample_takeda(shape, u)
    return _sample_slope(shape, tail, u)


def density(model: str, tail: str, shape: list[Any], view: Any, light: Any) -> Any:
    """Density in solid angle of the light that `sample_half_vector` leads to from `view`."""
    x, y, z = view.x + light.x, view.y + light.y, view.z + light.z
    square = x * x + y * y + z * z  # |v + l|² = (2 v·h)²
    if model == "takeda2008":
        return _density_takeda(shape, view, light) / dr.maximum(2 * dr.sqrt(square), 1e-6)
    mx, my, xx, xy, yy = shape
    lobe = models.slope_lobe(x / z, y / z, mx, my, xx, xy, yy, tail, xp=dr)
    return lobe * square / (2 * dr.pi * dr.sqrt(xx * yy - xy * xy) * z * z * z)


def _sample_slope(shape: list[Any], tail: str, u: Any) -> Any:
    x, y, xx, xy, yy = shape
    rest = dr.maximum(1 - u.x, 1e-7)
    r = dr.sqrt(-dr.log(rest) if tail == "gaussian" else (1 - rest) / rest)
    s, c = dr.sincos(dr.two_pi * u.y)
    a = dr.sqrt(xx)  # Cholesky factor of S: (a 0; b d)
    b = xy / a
    d = dr.sqrt(dr.maximum(yy - b * b, 0))
    return dr.normalize(mi.Vector3f(x + a * r * c, y + b * r * c + d * r * s, 1))


# Eq. 3 in θ: density ∝ θ exp(−((θ − m) / s)²) on [0, π/2]. A density without the factor θ has a spike
# 1 / sin θ at the pole, which no weight and no quadrature grid takes well. With x = (θ − m) / s its
# antiderivative is s times `_primitive`.


def _primitive(x: Any, m: Any, s: Any) -> Any:
    return 0.5 * dr.sqrt(dr.pi) * m * dr.erf(x) - 0.5 * s * dr.exp(-x * x)


def _polar_range(m: Any, s: Any) -> tuple[Any, Any, Any, Any]:
    low, high = -m / s, (0.5 * dr.pi - m) / s
    return low, high, _primitive(low, m, s), _primitive(high, m, s)


def _density_takeda(shape: list[Any], view: Any, light: Any) -> Any:
    theta, phi, dt, dp = shape
    theta_h, phi_h = models.half_angles(view, light, xp=dr)
    _, _, start, end = _polar_range(theta, dt)
    norm = dt * (end - start) * dp * dr.sqrt(dr.pi) * dr.erf(dr.pi / dp)
    ratio = dr.select(theta_h > 1e-4, theta_h / dr.maximum(dr.sin(theta_h), 1e-5), 1)
    value = models.takeda_lobe(theta_h, phi_h, theta, phi, dt, dp, xp=dr) * ratio
    return dr.select(norm > 0, value / dr.maximum(norm, 1e-30), 0)


def _sample_takeda(shape: list[Any], u: Any) -> Any:
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
        # with strict comparisons it oscillates
        x = dr.select((step >= low) & (step <= high), step, 0.5 * (low + high))
    polar = dr.clip(theta + dt * x, 0, 0.5 * dr.pi)
    spread = dr.clip((2 * u.y - 1) * dr.erf(dr.pi / dp), -ALMOST_ONE, ALMOST_ONE)
    st, ct = dr.sincos(polar)
    sp, cp = dr.sincos(phi + dp * dr.erfinv(spread))
    return mi.Vector3f(st * cp, st * sp, ct)
