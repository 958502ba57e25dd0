"""Samples of some texels of each region, evenly through it: what priors and choices are made on."""

import numpy as np
from numpy.typing import NDArray

from kinran.fit import samples
from kinran.labels import LabelMap
from kinran.stack import Stack

Single = NDArray[np.float32]
Labels = NDArray[np.intp]


def of_regions(stack: Stack, labels: LabelMap, count: int, most: int) -> tuple[Single, Single, Labels]:
    """Samples of at most so many texels of each of `count` regions.

    Returns
    -------
    T : (texel, 3, light) float32
    W : (texel, light) float32
    at : (texel,) int
        Their places in the flattened map.
    """
    chosen = np.zeros(labels.size, bool)
    for k in range(count):
        inside = np.flatnonzero(labels.reshape(-1) == k)
        chosen[inside[np.linspace(0, len(inside) - 1, min(most, len(inside))).astype(int)]] = True
    chosen_map = chosen.reshape(labels.shape)
    places = np.arange(labels.size).reshape(labels.shape)
    T, W, at = [], [], []
    for tile in samples.iterate(stack, stack.tiles()):
        y0, y1, x0, x1 = tile.box
        inside = chosen_map[y0:y1, x0:x1].reshape(-1)
        T.append(tile.T[inside])
        W.append(tile.W[inside])
        at.append(places[y0:y1, x0:x1].reshape(-1)[inside])
    return np.concatenate(T), np.concatenate(W), np.concatenate(at)
