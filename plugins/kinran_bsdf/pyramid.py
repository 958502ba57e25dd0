"""Prefiltered maps for fabric seen from far away.

A texel of level k stands for 2ᵏ × 2ᵏ texels of the map: its lobe has their energy, their mean slope, and the
variance of all their slopes [LEAN mapping, Olano & Baker 2010], so that what was a weave becomes roughness.
Moments of slopes average linearly; angles do not, so that `takeda2008` has no pyramid.
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba
import numpy as np
from numpy.typing import NDArray

from kinran_bsdf import models

mi: Any = mitsuba  # its types are those of the variant, at run time

Map = NDArray[np.float32]


def halve(packed: Map, bands: int, lobes: int) -> Map:
    """Next level of packed slope maps (H, W, n), half as large.

    Parameters
    ----------
    packed
        Colour · amplitude and shape of the diffuse term, then of each lobe; whatever follows is averaged.
    bands
        Number of channels of a colour.
    """
    colour, slopes = packed[..., :bands], packed[..., bands : bands + 2]
    weight = colour.sum(-1, keepdims=True)
    parts = [mean(colour), _weighted(slopes, weight)]
    rest = bands + 2 + lobes * (bands + 5)
    for start in range(bands + 2, rest, bands + 5):
        colour = packed[..., start : start + bands]
        x, y, xx, xy, yy = np.moveaxis(packed[..., start + bands : start + bands + 5], -1, 0)
        unit = models.slope_albedo(x, y, xx, xy, yy)[..., None]
        weight = colour.sum(-1, keepdims=True) * unit
        # G = exp(−dᵀ S⁻¹ d) has the covariance S / 2
        moments = np.stack([x, y, xx + 2 * x * x, xy + 2 * x * y, yy + 2 * y * y], -1)
        shape = _weighted(moments, weight)
        x, y = shape[..., 0], shape[..., 1]
        shape[..., 2:] -= 2 * np.stack([x * x, x * y, y * y], -1)
        energy = mean(colour * unit)
        parts += [energy / models.slope_albedo(*np.moveaxis(shape, -1, 0))[..., None], shape]
    parts.append(mean(packed[..., rest:]))
    return np.concatenate(parts, -1, dtype=np.float32)


def mean(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Box filter to half the size, rounded down; an odd size gives cells of a little over two texels."""
    result = np.asarray(values, np.float64)
    for axis in (0, 1):
        size = result.shape[axis]
        if size % 2 == 0:
            one, other = ((slice(k, None, 2),) if axis == 0 else (slice(None), slice(k, None, 2)) for k in (0, 1))
            result = 0.5 * (result[one] + result[other])
        elif size > 1:
            edges = np.linspace(0, size, size // 2 + 1)
            whole = np.minimum(edges.astype(int), size - 1)
            part = np.expand_dims(edges - whole, tuple({0, 1, 2} - {axis}))
            before = np.cumsum(result, axis) - result
            sums = np.take(before, whole, axis) + part * np.take(result, whole, axis)
            result = np.diff(sums, axis=axis) * (size // 2 / size)
    return result


def _weighted(values: Map, weight: Map) -> NDArray[np.float64]:
    total = mean(weight)
    return np.where(total > 0, mean(values * np.float64(weight)) / np.where(total > 0, total, 1), mean(values))


class Pyramid:
    """Levels 1 and up of packed maps in one texture, each with a border that makes it repeat or stay."""

    def __init__(self, packed: Map, halve: Callable[[Map], Map], wrap_mode: str) -> None:
        levels = []
        while max(packed.shape[:2]) > 1:
            packed = halve(packed)
            levels.append(packed)
        levels = levels or [packed]
        self.wrap_mode, self.count = wrap_mode, len(levels)
        rows = [level.shape[0] + 2 for level in levels]
        self.size = (sum(rows), max(level.shape[1] for level in levels) + 2)
        atlas = np.zeros((*self.size, packed.shape[-1]), np.float32)
        layout, top = [], 0
        for level, height in zip(levels, rows, strict=True):
            border = np.pad(level, ((1, 1), (1, 1), (0, 0)), mode="wrap" if wrap_mode == "repeat" else "edge")
            atlas[top : top + height, : border.shape[1]] = border
            layout.append([level.shape[1], level.shape[0], top + 1])
            top += height
        self.layout = mi.Texture1f(mi.TensorXf(np.array(layout, np.float32)), filter_mode=dr.FilterMode.Nearest)
        self.texture = mi.Texture2f(
            mi.TensorXf(atlas),
            use_accel=False,
            migrate=False,
            filter_mode=dr.FilterMode.Linear,
            wrap_mode=dr.WrapMode.Clamp,
        )

    def fetch(self, uv: Any, level: Any, active: Any) -> Any:
        """Packed channels at `uv` of the level nearest to `level`, from 1 up."""
        width, height, top = self.layout.eval(
            dr.clip(dr.round(level) - 0.5, 0.5, self.count - 0.5) / self.count, active
        )
        if self.wrap_mode == "repeat":
            u, v = uv.x - dr.floor(uv.x), uv.y - dr.floor(uv.y)
        else:
            u, v = dr.clip(uv.x, 0, 1), dr.clip(uv.y, 0, 1)
        rows, columns = self.size
        return self.texture.eval(mi.Point2f((1 + u * width) / columns, (top + v * height) / rows), active)
