"""Samples of a stack as the fits take them: texels first, with weights."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran import encoding
from kinran.stack import HOT, SATURATED, SHIFTED, Stack

SATURATED_WEIGHT = 0.2
"""A saturated sample says only 'at least this much': it keeps a little of its say."""

SIDE = 16
"""Lights of a block of the reordering, and half of its texels."""

Box = tuple[int, int, int, int]


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
    """

    box: Box
    T: NDArray[np.float32]
    W: NDArray[np.float32]


def training_lights(stack: Stack) -> NDArray[np.intp]:
    """Indices of the lights that fits may see."""
    return np.flatnonzero(~np.array([light.held_out for light in stack.lights]))


def training_directions(stack: Stack) -> NDArray[np.float64]:
    """Directions (n, 3) of the lights that fits may see."""
    return np.array([stack.lights[i].direction for i in training_lights(stack)], float)


def read(stack: Stack, box: Box) -> Samples:
    """Samples of one tile under the training lights."""
    radiance, flags = stack.read_tile(*box, lights=training_lights(stack))
    T, W = texels_first(radiance, flags, _weights(SATURATED_WEIGHT if stack.encoding else 0.0))
    if stack.encoding:
        W *= encoding.parse(stack.encoding).weight(T.mean(1))
    return Samples(box, T, W)


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
    T, W = np.empty((texels, channels, n), np.float32), np.empty((texels, n), np.float32)
    images = np.ascontiguousarray(radiance, np.float16).reshape(n, texels * channels)
    bits = np.ascontiguousarray(flags).reshape(n, texels * channels)
    _turn(images.view(np.uint16), bits, weight_of, T, W)
    return T, W


def _weights(saturated: float) -> NDArray[np.float32]:
    """Weight by flags: `saturated` for what only says 'at least this much', 0 for defects and what had moved."""
    bits = np.arange(256)
    weight = np.where(bits & SATURATED, saturated, 1.0)
    return np.where(bits & (HOT | SHIFTED), 0.0, weight).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _single(half: np.uint16) -> np.float32:
    """Single precision of a float16, by its bits."""
    # exponent and fraction moved in place, then the difference of the biases made up for by a power of 2
    value = np.uint32(np.uint32(half & np.uint16(0x7FFF)) << np.uint32(13)).view(np.float32) * np.float32(2.0**112)
    value = np.float32(np.nan) if half & np.uint16(0x7C00) == np.uint16(0x7C00) else value
    return -value if half & np.uint16(0x8000) else value


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(
    images: NDArray[np.uint16],
    bits: NDArray[np.uint8],
    weight_of: NDArray[np.float32],
    T: NDArray[np.float32],
    W: NDArray[np.float32],
) -> None:
    """Turn (light, texel · channel) round, by blocks that use the cache lines of both orders whole."""
    n, texels = images.shape[0], len(T)
    block, flag = np.empty((SIDE, 6 * SIDE), np.float32), np.empty((SIDE, 6 * SIDE), np.uint8)
    for t0 in range(0, texels, 2 * SIDE):
        width = min(2 * SIDE, texels - t0)
        for i0 in range(0, n, SIDE):
            height = min(SIDE, n - i0)
            flagged = np.uint8(0)
            for i in range(height):
                source, target = images[i0 + i, 3 * t0 : 3 * (t0 + width)], block[i]
                for k in range(3 * width):
                    target[k] = _single(source[k])
                mark, kept = bits[i0 + i, 3 * t0 : 3 * (t0 + width)], flag[i]
                for k in range(3 * width):
                    kept[k] = mark[k]
                    flagged |= mark[k]
            for t in range(width):
                for c in range(3):
                    row, k = T[t0 + t, c, i0 : i0 + height], 3 * t + c
                    for i in range(height):
                        row[i] = block[i, k]
                weights = W[t0 + t, i0 : i0 + height]
                if flagged:
                    for i in range(height):
                        weights[i] = weight_of[flag[i, 3 * t] | flag[i, 3 * t + 1] | flag[i, 3 * t + 2]]
                else:
                    weights[:] = weight_of[0]


def share(boxes: list[Box], tile: str) -> list[Box]:
    """The run of tiles that job ``i/n`` (from 0) has to do."""
    index, count = (int(part) for part in tile.split("/"))
    cuts = np.linspace(0, len(boxes), count + 1).round().astype(int)
    return boxes[cuts[index] : cuts[index + 1]]


def cut(labels: NDArray[np.intp], box: Box) -> NDArray[np.intp]:
    """Labels (texel,) of a tile."""
    return labels[box[0] : box[1], box[2] : box[3]].reshape(-1)


def iterate(stack: Stack, boxes: list[Box]) -> Iterator[Samples]:
    """Samples of tiles, one at a time."""
    for box in boxes:
        yield read(stack, box)
