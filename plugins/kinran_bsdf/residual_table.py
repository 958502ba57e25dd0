"""The residual at a point of a scene: its spline over lights as a table, and what its maps mean under a light."""

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
"""Side of the table of the spline over (l_x, l_y) in [-1, 1]²."""
BOUND_FLOOR = 1e-3
LIGHTS_EACH = 2
"""Lights for each map that `averaged` finds; with all of them it is no better."""


class ResidualTable:
    """What turns the maps of a material's residual into light."""

    def __init__(self, material: Material, residual: Residual) -> None:
        self.residual, self.count = residual, residual.count
        x, y = np.meshgrid(*2 * [(np.arange(TABLE) + 0.5) / TABLE * 2 - 1])
        factors = residual.basis(np.stack([x.ravel(), y.ravel()], -1))[:, 1:]
        self.table = texture(factors.reshape(TABLE, TABLE, -1).astype(np.float32))
        to_stack = np.linalg.inv(colours.TO_REC709 @ material.from_stack) * np.pi
        self.to_stack, self.from_stack = to_stack.tolist(), np.linalg.inv(to_stack).tolist()

    def change(self, lobes: list[Any], maps: list[Any], light: Any, active: Any) -> list[Any]:
        """What the residual adds to T in Rec. 709.

        Parameters
        ----------
        lobes
            T of the lobes in Rec. 709 (3 values) under `light` at the measured view.
        maps
            Mean and components of the residual (3 values each), then `bound`, by which the lobes are scaled.
        light
            Direction towards the light, in the fabric's frame.
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
        """Share of the lobes in display-like values of the stack's RGB."""
        fitted = [lobe / xp.maximum(bound, BOUND_FLOOR) for lobe in lobes]
        linear = [sum(m * f for m, f in zip(row, fitted, strict=True)) for row in self.to_stack]
        return [self.residual.share * compress(value, self.residual.domain, xp=xp) for value in linear]

    def _left(self, maps: list[Any], factors: Any) -> list[Any]:
        return [sum(maps[3 * k + c] * factors[k] for k in range(self.count + 1)) for c in range(3)]

    def averaged(self, fine: Map, coarse: Map, radiance: Callable[[list[Map], Array], list[Map]]) -> Map:
        """Residual of the next level of a pyramid, whose texels show the mean of what theirs show.

        That is not what the mean of their residuals shows, since display-like values are not linear in light. Least
        squares in these values over the fitted lights, of which a part is enough.

        Parameters
        ----------
        fine, coarse : (H, W, n), (h, w, n) float32
            Channels of a level, and of the next with its lobes and its `bound` in place.
        radiance
            T of the lobes in Rec. 709 (3 maps) of such channels under a light at the measured view.

        Returns
        -------
        (h, w, 3 · (count + 1)) float32
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
