"""The residual at a point of a scene: its spline over lights as a table, and what its maps mean under a light."""

from typing import Any

import drjit as dr
import mitsuba
import numpy as np

from kinran_bsdf import colours
from kinran_bsdf.material import Material
from kinran_bsdf.residual import Residual, compress, expand

mi: Any = mitsuba  # its types are those of the variant, at run time

TABLE = 128
"""Side of the table of the spline over (l_x, l_y) in [-1, 1]²."""


class ResidualTable:
    """What turns the maps of a material's residual into light."""

    def __init__(self, material: Material, residual: Residual) -> None:
        self.count, self.domain, self.share = residual.count, residual.domain, residual.share
        x, y = np.meshgrid(*2 * [(np.arange(TABLE) + 0.5) / TABLE * 2 - 1])
        factors = residual.basis(np.stack([x.ravel(), y.ravel()], -1))[:, 1:]
        self.table = mi.Texture2f(
            mi.TensorXf(factors.reshape(TABLE, TABLE, -1).astype(np.float32)),
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Clamp,
            use_accel=False,
            migrate=False,
        )
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
        bound = dr.maximum(maps[-1], 1e-3)
        factors = [1.0, *self.table.eval(mi.Point2f(0.5 * light.x + 0.5, 0.5 * light.y + 0.5), active)]
        fitted = [lobe / bound for lobe in lobes]
        shown = []
        for c in range(3):
            linear = sum(m * f for m, f in zip(self.to_stack[c], fitted, strict=True))
            left = sum(maps[3 * k + c] * factors[k] for k in range(self.count + 1))
            shown.append(expand(self.share * compress(linear, self.domain, xp=dr) + left, self.domain, xp=dr))
        whole = [sum(m * f for m, f in zip(row, shown, strict=True)) * bound for row in self.from_stack]
        return [w - lobe for w, lobe in zip(whole, lobes, strict=True)]
