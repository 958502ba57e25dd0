"""Samples of a stack as the fits take them: texels first, with weights."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran import encoding
from kinran.stack import HOT, SATURATED, SHIFTED, Stack

SATURATED_WEIGHT = 0.2
"""A saturated sample says only 'at least this much': it keeps a little of its say."""

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
    n, height, width, channels = radiance.shape
    T = np.ascontiguousarray(radiance.reshape(n, height * width, channels).transpose(1, 2, 0))
    bits = np.bitwise_or.reduce(flags.reshape(n, height * width, channels), axis=2).T
    W = np.ones(bits.shape, np.float32)
    if stack.encoding:
        W = encoding.parse(stack.encoding).weight(T.mean(1))
        W[(bits & SATURATED) > 0] *= SATURATED_WEIGHT
    else:
        W[(bits & SATURATED) > 0] = 0
    W[(bits & (HOT | SHIFTED)) > 0] = 0
    return Samples(box, T, W)


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
