"""Samples of a fabric as the fits take them: texels first, with weights, and with the directions they were taken under.

`read_samples` is the only way from a stack to a fit, its priors, its choices, its residual and its uncertainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base import encoding
from kinran.data.fabric import Fabric
from kinran.data.labels import LabelMap
from kinran.data.radiance import HOT, SATURATED, SHIFTED
from kinran.data.radiance_stack import Box, Stack
from kinran.data.texel_directions import Index, Under, join, under
from kinran.fit.solver import prepare
from kinran.fit.solver.turn import SINGLE, turn

Single = NDArray[np.float32]
Labels = NDArray[np.intp]
T_ = TypeVar("T_", bound=np.generic)

SATURATED_WEIGHT = 0.2
"""Weight of a saturated sample of a photograph, whose true value is at least the stored one. A choice; no command
compares other weights. `kinran.fit.bounded` refits these samples as bounds."""


@dataclass(frozen=True)
class Samples:
    """Samples of some texels under the same lamps.

    Attributes
    ----------
    T : (texel, 3, light) float32
        Radiance in the stack's unit, without the falloff of the lamps.
    W : (texel, light) float32
        Weights; 0 for samples that are not used.
    under
        Directions under which the texels were seen.
    region, second : (texel,) int
        Region of each texel, and the region that shares the texel; the same where none does.
    bounds : (texel, light) float32 or None
        Weights of saturated samples as lower bounds; 0 elsewhere. None where nothing is saturated.
    """

    T: Single
    W: Single
    under: Under
    region: Labels
    second: Labels
    bounds: Single | None = None

    @classmethod
    def far(
        cls,
        T: Single,
        W: Single,
        lights: ArrayLike,
        region: Labels | None = None,
        second: Labels | None = None,
        bounds: Single | None = None,
    ) -> "Samples":
        """Samples (texel, 3, light) under lights (light, 3) that are far away; one region by default."""
        where = np.zeros(len(T), np.intp) if region is None else region
        return cls(T, W, Under.far(lights, len(T)), where, where if second is None else second, bounds)

    def __len__(self) -> int:
        return len(self.T)

    def usable(self) -> NDArray[np.bool_]:
        """Mask (texel, 3, light) of the samples that are finite and have weight."""
        return (self.W > 0)[:, None] & np.isfinite(self.T)

    def of(self, texels: Index) -> "Samples":
        """Samples of some of the texels."""
        bounds = None if self.bounds is None else self.bounds[texels]
        region, second = self.region[texels], self.second[texels]
        return Samples(self.T[texels], self.W[texels], self.under.of(texels), region, second, bounds)

    def only(self, lights: Index) -> "Samples":
        """Samples under some of the lights."""
        T, W = np.ascontiguousarray(self.T[..., lights]), np.ascontiguousarray(self.W[:, lights])
        bounds = None if self.bounds is None else np.ascontiguousarray(self.bounds[:, lights])
        return replace(self, T=T, W=W, bounds=bounds, under=self.under.only(lights))

    def weighed(self, by: Single) -> "Samples":
        """Samples whose weights are multiplied by factors (light,)."""
        return replace(self, W=self.W * by, bounds=None if self.bounds is None else self.bounds * by)

    def where(self, sound: NDArray[np.bool_]) -> "Samples":
        """The samples without those that are not `sound` (texel, light): 0, and of no weight."""
        bounds = None if self.bounds is None else np.where(sound, self.bounds, np.float32(0))
        T, W = np.where(sound[:, None], self.T, np.float32(0)), np.where(sound, self.W, np.float32(0))
        return replace(self, T=T, W=W, bounds=bounds)

    def unshared(self) -> "Samples":
        """The samples with no texel shared between two regions."""
        return replace(self, second=self.region)


def training_lights(stack: Stack) -> NDArray[np.intp]:
    """Indices (light,) of the lights that fits may see."""
    return np.flatnonzero(~stack.held_out)


def read_samples(fabric: Fabric, box: Box) -> Samples:
    """Samples of one tile of a fabric under the training lights."""
    stack = fabric.stack
    lights = training_lights(stack)
    radiance, flags = stack.read_stored(*box, lights=lights)
    T, W = texels_first(radiance, flags, _weights(SATURATED_WEIGHT if stack.encoding else 0.0))
    display = encoding.parse(stack.encoding).weight(T.mean(1)) if stack.encoding else np.ones_like(W)
    bits = (flags[..., 0] | flags[..., 1] | flags[..., 2]).reshape(len(flags), -1).T
    saturated = (bits & SATURATED) > 0
    bounds = np.where(saturated & ((bits & (HOT | SHIFTED)) == 0), display, 0) if saturated.any() else None
    given = under(stack, box, lights)
    return Samples(
        given.square_on(T),
        W * display,
        given,
        cut(fabric.labels, box),
        cut(fabric.second, box),
        None if bounds is None else bounds.astype(np.float32),
    )


def read_some(fabric: Fabric, chosen: NDArray[np.bool_]) -> Samples:
    """Samples of the texels of a fabric in a mask (y, x), in the order of the tiles."""
    parts = []
    for box in fabric.stack.tiles():
        inside = np.flatnonzero(chosen[box[0] : box[1], box[2] : box[3]])
        if inside.size:
            parts.append(read_samples(fabric, box).of(inside))
    return concatenated(parts)


def concatenated(parts: Sequence[Samples]) -> Samples:
    """Join samples of texels under the same lamps, one part after the other."""
    bounds = None
    if any(part.bounds is not None for part in parts):
        bounds = np.concatenate([np.zeros_like(p.W) if p.bounds is None else p.bounds for p in parts])
    T, W, region, second = (
        np.concatenate([getattr(p, name) for p in parts]) for name in ("T", "W", "region", "second")
    )
    return Samples(T, W, join([part.under for part in parts]), region, second, bounds)


def spread_over_regions(
    labels: LabelMap | Labels, regions: int, most: int, measured: NDArray[np.bool_] | None = None
) -> NDArray[np.bool_]:
    """Mask, (y, x) or (texel,) as the labels, of at most `most` texels of each region, evenly through it.

    Texels that are not among `measured`, a mask like the labels, are left out.
    """
    chosen = np.zeros(labels.size, bool)
    of = labels.reshape(-1)
    for k in range(regions):
        inside = np.flatnonzero((of == k) if measured is None else (of == k) & measured.reshape(-1))
        chosen[inside[np.linspace(0, len(inside) - 1, min(most, len(inside))).astype(int)]] = True
    return chosen.reshape(labels.shape)


def texels_first(
    radiance: NDArray[np.floating], flags: NDArray[np.uint8], weight_of: NDArray[np.float32]
) -> tuple[Single, Single]:
    """Reorder a tile from images to texels.

    Parameters
    ----------
    radiance : (light, y, x, 3)
        In float16, which is what a stack holds.
    flags : (light, y, x, 3) uint8
    weight_of : (256,) float32
        Weight of a sample by the union of its channels' flags.

    Returns
    -------
    T : (texel, 3, light) float32
    W : (texel, light) float32
    """
    prepare()
    n, height, width, channels = radiance.shape
    texels = height * width
    values = _padded(np.ascontiguousarray(radiance, np.float16).reshape(n, texels * channels), 4)
    of = flags.reshape(n, texels, channels)
    bits = _padded(of[..., 0] | of[..., 1] | of[..., 2], 8)
    T, W = np.empty((values.shape[1], n), np.float32), np.empty((bits.shape[1], n), np.float32)
    turn(values.view(np.uint64), bits.view(np.uint64), SINGLE, weight_of, T, W)
    return T[: texels * channels].reshape(texels, channels, n), W[:texels]


def _padded(rows: NDArray[T_], multiple: int) -> NDArray[T_]:
    """Rows padded with zeros to a multiple of this length."""
    missing = -rows.shape[1] % multiple
    return np.ascontiguousarray(np.pad(rows, ((0, 0), (0, missing))) if missing else rows)


def _weights(saturated: float) -> Single:
    """Weight (256,) by flags: `saturated` for saturated samples, 0 for defects and for samples that had moved."""
    bits = np.arange(256)
    weight = np.where(bits & SATURATED, saturated, 1.0)
    return np.where(bits & (HOT | SHIFTED), 0.0, weight).astype(np.float32)


def cut(labels: LabelMap, box: Box) -> Labels:
    """Labels (texel,) of a tile."""
    return labels[box[0] : box[1], box[2] : box[3]].reshape(-1).astype(np.intp)
