"""The model `slope`: elliptical lobes in slope space, the pipeline's default."""

from dataclasses import dataclass
from types import ModuleType
from typing import Any, ClassVar

import drjit as dr
import numpy as np

from kinran_bsdf.arrays import Map, Mask, mi
from kinran_bsdf.models.model import WIDTH_FLOOR, Model, release

TAILS = ("gaussian", "ggx")
"""Tails of the lobes; the shape of ``ggx`` is that of Walter2007."""


@dataclass(frozen=True)
class Slope(Model):
    """Elliptical lobes in slope space: G = exp(−q), or (1 + q)⁻² with the GGX tail.

    q = dᵀ S⁻¹ d with d = (h_x / h_z, h_y / h_z) − μ; S is the matrix of squared widths. Both tails integrate to
    π √|S| over slopes. At other views than N a lobe is lifted (`lobe_lift`).

    Attributes
    ----------
    tail
        Tail of the lobes: ``gaussian`` or ``ggx``.
    lobes
        Number of lobes: 1 or 2.
    x, y
        Parameters of a lobe: mean slope μ of its facets along weft and warp.
    xx, xy, yy
        Parameters of a lobe: elements of S, positive definite.
    """

    tail: str = "gaussian"
    lobes: int = 1

    name = "slope"
    parameters: ClassVar = {"x": 0.0, "y": 0.0, "xx": 0.04, "xy": 0.0, "yy": 0.04}
    counts = (1, 2)
    filtered = True

    @classmethod
    def of(cls, tail: str, lobes: int) -> "Slope":
        return cls(tail, lobes)

    @property
    def spread(self) -> int:
        # exp(−dᵀ S⁻¹ d) has the covariance S / 2; a GGX lobe, (1 + q)⁻², falls at its centre as exp(−2 q) does
        return 2 if self.tail == "gaussian" else 4

    def of_slopes(
        self, hx_over_hz: Any, hy_over_hz: Any, x: Any, y: Any, xx: Any, xy: Any, yy: Any, *, xp: ModuleType = np
    ) -> Any:
        """Return G at slopes of the half vector."""
        dx, dy = hx_over_hz - x, hy_over_hz - y
        q = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
        if self.tail == "gaussian":
            return xp.exp(-q)
        root = 1 / (1 + q)
        return root * root

    def value(self, view: Any, light: Any, shape: Any, *, xp: ModuleType = np) -> Any:
        z = view[2] + light[2]
        return self.of_slopes((view[0] + light[0]) / z, (view[1] + light[1]) / z, *shape, xp=xp)

    def lobe(self, view: Any, light: Any, shape: Any, floor: Any, *, xp: ModuleType = np) -> Any:
        return self.value(view, light, shape, xp=xp) * lobe_lift(view, light, floor, xp=xp)

    def albedo(self, shape: Any, *, xp: ModuleType = np) -> Any:
        """Return 4 ∫ G h_z⁴ dx dy ≈ 4π √|S| / (1 + |μ|² + tr S / 2)²."""
        x, y, xx, xy, yy = shape
        z = 1 / (1 + x * x + y * y + 0.5 * (xx + yy))
        return 4 * np.pi * xp.sqrt(xp.maximum(xx * yy - xy * xy, 0.0)) * z * z

    def integral(self, shape: Map, nodes: int) -> Map:
        """Return 4 ∫ G h_z⁴ dx dy over slopes under 1 (lights above the horizon), by nodes of equal energy."""
        x, y, xx, xy, yy = shape
        a = np.sqrt(xx)
        b, c = xy / a, np.sqrt(np.maximum(yy - xy * xy / xx, 0))
        total = np.zeros_like(x)
        for i in range(nodes):
            u = (i + 0.5) / nodes
            r = np.sqrt(-np.log1p(-u) if self.tail == "gaussian" else u / (1 - u))
            for j in range(nodes):
                turn = 2 * np.pi * (j + 0.5 * (i % 2)) / nodes
                p, q = float(r * np.cos(turn)), float(r * np.sin(turn))
                square = (x + a * p) ** 2 + (y + b * p + c * q) ** 2
                total += (square < 1) / (1 + square) ** 2
        return total * a * c * np.float32(4 * np.pi / nodes**2)

    def without_width(self, shape: Any) -> Mask:
        _, _, xx, xy, yy = shape
        return np.asarray((xx <= 0) | (yy <= 0) | (xx * yy - xy * xy < 0))

    def floor_widths(self, shape: Map) -> None:
        xx, xy, yy = np.moveaxis(shape[..., 2:], -1, 0)
        lack = np.maximum(np.float32(WIDTH_FLOOR**2) - (xx + yy - np.hypot(xx - yy, 2 * xy)) / 2, 0)
        xx += lack
        yy += lack

    def confined(self, shape: list[Any]) -> list[Any]:
        xx, yy = (dr.maximum(shape[i], WIDTH_FLOOR**2) for i in (2, 4))
        most = 0.999 * dr.sqrt(xx * yy)
        return [*shape[:2], xx, dr.clip(shape[3], -most, most), yy]

    def sample(self, shape: list[Any], u: Any) -> Any:
        x, y, xx, xy, yy = shape
        rest = dr.maximum(1 - u.x, 1e-7)
        r = dr.sqrt(-dr.log(rest) if self.tail == "gaussian" else (1 - rest) / rest)
        s, c = dr.sincos(dr.two_pi * u.y)
        a = dr.sqrt(xx)  # Cholesky factor of S: (a 0; b d)
        b = xy / a
        d = dr.sqrt(dr.maximum(yy - b * b, 0))
        return dr.normalize(mi.Vector3f(x + a * r * c, y + b * r * c + d * r * s, 1))

    def density(self, shape: list[Any], view: Any, light: Any) -> Any:
        x, y, z = view.x + light.x, view.y + light.y, view.z + light.z
        square = x * x + y * y + z * z  # |v + l|² = (2 v·h)²
        _, _, xx, xy, yy = shape
        value = self.of_slopes(x / z, y / z, *shape, xp=dr)
        return value * square / (2 * dr.pi * dr.sqrt(xx * yy - xy * xy) * z * z * z)


def lobe_lift(view: Any, light: Any, floor: Any, *, xp: ModuleType = np) -> Any:
    """Return the factor that extrapolates a slope lobe to any view: T = amplitude · colour · G(h) · lift.

    The lobe is taken as a distribution of facets, D = G: f_r = D W / (cos θ_v cos θ_l), with V-cavity masking
    ([Cook1982], without its factor of 2) that is released towards the measured view, where the data include masking:
    W = min(1, h_z / (v·h) · m), m the larger of min(cos θ_v, cos θ_l) and max(cos θ_v, cos θ_l)⁸. The BRDF is symmetric
    in v and l. The factor is 1 at V = N down to `floor`, the cosine of the lowest measured light, from which T fades to
    0 at the horizon.
    """
    cv, cl = view[2], light[2]
    z = cv + cl
    x, y = view[0] + light[0], view[1] + light[1]
    tilt = 2 * z / (x * x + y * y + z * z)  # h_z / (v·h)
    masking = xp.minimum(1.0, tilt * xp.maximum(release(view, light, xp=xp), xp.minimum(cv, cl)))
    return masking * cl / (xp.maximum(cv, floor) * xp.maximum(cl, floor))
