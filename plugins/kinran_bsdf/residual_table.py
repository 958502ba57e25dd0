"""The residual at a point of a scene: its spline over lights as a table, and the light of its maps."""

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from kinran_bsdf import colours
from kinran_bsdf.arrays import Array, Map, mi, texture
from kinran_bsdf.material import Material
from kinran_bsdf.mixture import mean
from kinran_bsdf.residual import Residual, compress, expand

TABLE = 128
"""Side of the table of the spline over (l_x, l_y) in [-1, 1]²: a choice."""
BOUND_FLOOR = 1e-3
"""Least `bound` that is divided by, since masked look-ups give 0. A choice: a material's `bound` is lower only where
its albedo exceeds 1000."""
LIGHTS_EACH = 2
"""Lights per map in the least squares of `averaged`; more lights are no better."""


class ResidualTable:
    """The residual of a material in a renderer, which turns its maps into light."""

    def __init__(self, material: Material, residual: Residual) -> None:
        self.residual, self.count = residual, residual.count
        x, y = np.meshgrid(*2 * [(np.arange(TABLE) + 0.5) / TABLE * 2 - 1])
        factors = residual.basis(np.stack([x.ravel(), y.ravel()], -1))[:, 1:]
        self.table = texture(factors.reshape(TABLE, TABLE, -1).astype(np.float32))
        to_stack = np.linalg.inv(colours.TO_REC709 @ material.from_stack) * np.pi
        self.to_stack, self.from_stack = to_stack.tolist(), np.linalg.inv(to_stack).tolist()

    def change(self, lobes: list[Any], maps: list[Any], light: Any, active: Any) -> list[Any]:
        """Return the change of T by the residual, three bands in Rec. 709.

        Parameters
        ----------
        lobes
            T of the lobes in Rec. 709 (3 values) under `light` at the measured view.
        maps
            Mean and components of the residual (3 values each), then `bound`, by which the lobes are scaled.
        light
            Direction towards the light, in the fabric's frame.
        active
            Mask of the points.
        """
        factors = [1.0, *self.table.eval(mi.Point2f(0.5 * light.x + 0.5, 0.5 * light.y + 0.5), active)]
        shown = [
            expand(value + left, self.residual.domain, xp=dr)
            for value, left in zip(self._lobes_shown(lobes, maps[-1], dr), self._left(maps, factors), strict=True)
        ]
        bound = dr.maximum(maps[-1], BOUND_FLOOR)
        whole = [sum(m * f for m, f in zip(row, shown, strict=True)) * bound for row in self.from_stack]
        return [w - lobe for w, lobe in zip(whole, lobes, strict=True)]

    def _lobes_shown(self, lobes: list[Any], bound: Any, xp: Any) -> list[Any]:
        """Return the lobes' share of a picture in display-like values of the stack's RGB."""
        fitted = [lobe / xp.maximum(bound, BOUND_FLOOR) for lobe in lobes]
        linear = [sum(m * f for m, f in zip(row, fitted, strict=True)) for row in self.to_stack]
        return [self.residual.share * compress(value, self.residual.domain, xp=xp) for value in linear]

    def _left(self, maps: list[Any], factors: Any) -> list[Any]:
        return [sum(maps[3 * k + c] * factors[k] for k in range(self.count + 1)) for c in range(3)]

    def averaged(self, fine: Map, coarse: Map, radiance: Callable[[list[Map], Array], list[Map]]) -> Map:
        """Return the residual of the next level of a pyramid, under which a texel has the mean radiance of its texels.

        The mean of their residuals does not give that, since display-like values are not linear in light. It is fitted
        by least squares in these values over some of the fitted lights.

        Parameters
        ----------
        fine, coarse : (H, W, n), (h, w, n) float32
            Channels of a level, and of the next level with its terms and `bound` in place.
        radiance
            Function of such channels and a light: T of the lobes in Rec. 709 (3 maps) at the measured view.

        Returns
        -------
        (h, w, 3 · (count + 1)) float32
            Mean and components of the residual.
        """
        count, at = self.count + 1, self.residual.lights
        at = at[:: max(1, len(at) // (LIGHTS_EACH * count))]
        lights = np.column_stack([at, np.sqrt(np.maximum(1 - (at**2).sum(1), 0))])
        factors = self.residual.basis(lights)
        here, there = (list(np.ascontiguousarray(np.moveaxis(level, -1, 0))) for level in (fine, coarse))
        result = np.zeros((*coarse.shape[:2], count, 3), np.float32)
        for light, row, column in zip(lights, factors, np.linalg.pinv(factors).T, strict=True):
            before = self._lobes_shown(radiance(here, light), here[-1], np)
            after = self._lobes_shown(radiance(there, light), there[-1], np)
            for c, left in enumerate(self._left(here[-3 * count - 1 : -1], row.astype(np.float32))):
                seen = expand(before[c] + left, self.residual.domain) * here[-1]
                seen = mean(seen) / there[-1]
                wanted = compress(seen, self.residual.domain) - after[c]
                result[..., c] += wanted[..., None] * column.astype(np.float32)
        return result.reshape(*coarse.shape[:2], -1)
