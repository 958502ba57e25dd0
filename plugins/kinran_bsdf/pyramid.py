"""Prefiltered maps for fabric seen from far away.

A texel of level k stands for 2ᵏ × 2ᵏ texels of the map: its lobes have their energy, and the mean and variance of their
slopes, so that the weave becomes roughness (`mixture`). Models that are not `filtered` have no pyramid.
"""

from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np

from kinran_bsdf import mixture
from kinran_bsdf.arrays import Map, mi, texture
from kinran_bsdf.mixture import mean
from kinran_bsdf.models import Model

BLOCK = 1 << 16
"""Texels that are reduced at a time: a block stays in the cache."""


def halve(packed: Map, weights: Map | None, bands: int, model: Model) -> tuple[Map, Map]:
    """Return the next level of packed maps, half as large, and the weights of its lobes.

    Parameters
    ----------
    packed : (H, W, n) float32
        Colour and shape of the diffuse term, then of each lobe; the channels after them are averaged.
    weights : (lobes, H, W) float32
        Weight of each lobe in the shapes; None where `packed` is the map itself.
    bands
        Number of channels of a colour.
    model
        Model of the lobes.
    """
    height, width = packed.shape[:2]
    rows = max(BLOCK // width // 2 * 2, 2) if height % 2 == 0 else height
    parts = [slice(top, top + rows) for top in range(0, height, rows)]
    found = [_halve(packed[p], None if weights is None else weights[:, p], bands, model) for p in parts]
    level, weights = np.concatenate([level for level, _ in found]), np.concatenate([w for _, w in found], 1)
    if model.lobes == 2:
        start, length = bands + 2, bands + 5
        terms = np.moveaxis(level[..., start : start + 2 * length].reshape(*level.shape[:2], 2, length), (2, 3), (0, 1))
        turned = mixture.out_of_order(terms[:, :bands], terms[:, bands:])
        terms[:, :, turned] = terms[::-1, :, turned]
        weights[:, turned] = weights[::-1, turned]
        level[..., start : start + 2 * length] = np.moveaxis(terms, (0, 1), (2, 3)).reshape(*level.shape[:2], -1)
    return level, weights


def _halve(packed: Map, weights: Map | None, bands: int, model: Model) -> tuple[Map, Map]:
    height, width = packed.shape[:2]
    planes = np.ascontiguousarray(np.moveaxis(packed, -1, 0))
    rest = bands + 2 + model.lobes * (bands + 5)
    colour, slopes = planes[:bands], planes[bands : bands + 2]
    terms = planes[bands + 2 : rest].reshape(model.lobes, bands + 5, height, width)
    energies, shapes = terms[:, :bands], terms[:, bands:]
    if weights is None:
        weights = mixture.weights_of(energies, shapes, model) if model.lobes else energies.sum(1)
    if model.lobes:
        energies, shapes, weights = mixture.reduced(energies, shapes, weights, model)
    terms = np.concatenate([energies, shapes], 1)
    weight = colour.sum(0)
    weight += np.float32(1e-9 * weight.mean() + 1e-30)
    levels = [mean(colour), mean(slopes * weight) / mean(weight), *terms, mean(planes[rest:])]
    return np.ascontiguousarray(np.moveaxis(np.concatenate(levels), 0, -1)), weights


class Pyramid:
    """Levels 1 and up of packed maps in one texture, each with a border that repeats it or continues its edge."""

    def __init__(self, packed: Map, halve: Callable[[Map, Map | None], tuple[Map, Map]], wrap_mode: str) -> None:
        levels: list[Map] = []
        weights = None
        while max(packed.shape[:2]) > 1:
            packed, weights = halve(packed, weights)
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
        self.texture = texture(atlas)

    def fetch(self, uv: Any, level: Any, active: Any) -> Any:
        """Return the packed channels at `uv` of the level nearest to `level`, from 1 up."""
        width, height, top = self.layout.eval(
            dr.clip(dr.round(level) - 0.5, 0.5, self.count - 0.5) / self.count, active
        )
        if self.wrap_mode == "repeat":
            u, v = uv.x - dr.floor(uv.x), uv.y - dr.floor(uv.y)
        else:
            u, v = dr.clip(uv.x, 0, 1), dr.clip(uv.y, 0, 1)
        rows, columns = self.size
        return self.texture.eval(mi.Point2f((1 + u * width) / columns, (top + v * height) / rows), active)
