"""Samples of a stack as the fits take them: texels first, with weights."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran import encoding
from kinran.labels import LabelMap
from kinran.radiance.value import HOT, SATURATED, SHIFTED
from kinran.stack import Stack

SATURATED_WEIGHT = 0.2
"""A saturated sample says only 'at least this much': it keeps a little of its say."""

RUN = 128
"""Lights that the reordering takes at a time: what it reads of their images, it finds in the cache again."""
SINGLE = np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""Single precision of each float16, by its bits."""

Box = tuple[int, int, int, int]
T_ = TypeVar("T_", bound=np.generic)


@dataclass(frozen=True)
class Samples:
    """Samples of a tile.

    Attributes
    ----------
    box
        (y0, y1, x0, x1) of the tile in the stack.
    T : (texel, 3, light) float32
        Radiance, in the stack's unit.
    W : (texel, light) float32
        Weights: 0 for what is not to be used.
    bounds : (texel, light) float32 or None
        Weights of saturated samples, as the lower bounds that they are; 0 elsewhere. None where nothing is saturated.
    """

    box: Box
    T: NDArray[np.float32]
    W: NDArray[np.float32]
    bounds: NDArray[np.float32] | None = None

    def part(self, at: NDArray[np.intp], factor: NDArray[np.float32]) -> "Samples":
        """Samples of some texels, divided by a factor (texel, light or 1)."""
        bounds = None if self.bounds is None else self.bounds[at]
        return Samples(self.box, np.ascontiguousarray(self.T[at] / factor[:, None]), self.W[at], bounds)

    def weighed(self, by: NDArray[np.float32]) -> "Samples":
        """With factors (light,) of the weights."""
        bounds = None if self.bounds is None else self.bounds * by
        return Samples(self.box, self.T, self.W * by, bounds)


def training_lights(stack: Stack) -> NDArray[np.intp]:
    """Indices of the lights that fits may see."""
    return np.flatnonzero(~np.array([light.held_out for light in stack.lights]))


def training_directions(stack: Stack) -> NDArray[np.float64]:
    """Directions (n, 3) of the lights that fits may see."""
    return np.array([stack.lights[i].direction for i in training_lights(stack)], float)


def read(stack: Stack, box: Box) -> Samples:
    """Samples of one tile under the training lights."""
    radiance, flags = stack.read_stored(*box, lights=training_lights(stack))
    T, W = texels_first(radiance, flags, _weights(SATURATED_WEIGHT if stack.encoding else 0.0))
    display = encoding.parse(stack.encoding).weight(T.mean(1)) if stack.encoding else np.ones_like(W)
    saturated = (flags & SATURATED).any(-1).reshape(len(flags), -1).T
    bounds = np.where(saturated & ~(flags & (HOT | SHIFTED)).any(-1).reshape(len(flags), -1).T, display, 0)
    return Samples(box, T, W * display, bounds.astype(np.float32) if saturated.any() else None)


def texels_first(
    radiance: NDArray[np.floating], flags: NDArray[np.uint8], weight_of: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Reorder a tile from images to texels.

    Parameters
    ----------
    radiance : (light, y, x, 3)
        As float16, which is what a stack holds.
    flags : (light, y, x, 3) uint8
    weight_of : (256,) float32
        Weight of a sample by the flags of its channels together.

    Returns
    -------
    T : (texel, 3, light) float32
    W : (texel, light) float32
    """
    n, height, width, channels = radiance.shape
    texels = height * width
    values = _padded(np.ascontiguousarray(radiance, np.float16).reshape(n, texels * channels), 4)
    of = flags.reshape(n, texels, channels)
    bits = _padded(of[..., 0] | of[..., 1] | of[..., 2], 8)
    T, W = np.empty((values.shape[1], n), np.float32), np.empty((bits.shape[1], n), np.float32)
    _turn(values.view(np.uint64), bits.view(np.uint64), SINGLE, weight_of, T, W)
    return T[: texels * channels].reshape(texels, channels, n), W[:texels]


def _padded(rows: NDArray[T_], multiple: int) -> NDArray[T_]:
    """Rows made as long as a multiple of something."""
    missing = -rows.shape[1] % multiple
    return np.ascontiguousarray(np.pad(rows, ((0, 0), (0, missing))) if missing else rows)


def _weights(saturated: float) -> NDArray[np.float32]:
    """Weight by flags: `saturated` for what only says 'at least this much', 0 for defects and what had moved."""
    bits = np.arange(256)
    weight = np.where(bits & SATURATED, saturated, 1.0)
    return np.where(bits & (HOT | SHIFTED), 0.0, weight).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(
    values: NDArray[np.uint64],
    bits: NDArray[np.uint64],
    single: NDArray[np.float32],
    weight_of: NDArray[np.float32],
    T: NDArray[np.float32],
    W: NDArray[np.float32],
) -> None:
    """Turn samples, four in a word of `values` (light, word), and flags, eight in one of `bits`, round.

    A word is read once, as reading down the lights is what costs: each is a page away from the last.
    """
    two, one = np.uint64(0xFFFF), np.uint64(0xFF)
    for first in range(0, len(values), RUN):
        last = min(first + RUN, len(values))
        for word in range(values.shape[1]):
            a, b, c, d = T[4 * word], T[4 * word + 1], T[4 * word + 2], T[4 * word + 3]
            for i in range(first, last):
                v = values[i, word]
                a[i], b[i] = single[v & two], single[(v >> np.uint64(16)) & two]
                c[i], d[i] = single[(v >> np.uint64(32)) & two], single[v >> np.uint64(48)]
        for word in range(bits.shape[1]):
            for k in range(0, 8, 4):
                a, b, c, d = W[8 * word + k], W[8 * word + k + 1], W[8 * word + k + 2], W[8 * word + k + 3]
                for i in range(first, last):
                    v = bits[i, word] >> np.uint64(8 * k)
                    a[i], b[i] = weight_of[v & one], weight_of[(v >> np.uint64(8)) & one]
                    c[i], d[i] = weight_of[(v >> np.uint64(16)) & one], weight_of[(v >> np.uint64(24)) & one]


def share(boxes: list[Box], tile: str) -> list[Box]:
    """The run of tiles that job ``i/n`` (from 0) has to do."""
    index, count = (int(part) for part in tile.split("/"))
    cuts = np.linspace(0, len(boxes), count + 1).round().astype(int)
    return boxes[cuts[index] : cuts[index + 1]]


def cut(labels: LabelMap, box: Box) -> NDArray[np.intp]:
    """Labels (texel,) of a tile."""
    return labels[box[0] : box[1], box[2] : box[3]].reshape(-1).astype(np.intp)


def iterate(stack: Stack, boxes: list[Box]) -> Iterator[Samples]:
    """Samples of tiles, one at a time."""
    for box in boxes:
        yield read(stack, box)
