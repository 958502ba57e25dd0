"""Means of blocks of texels or pixels, with their flags."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.data.radiance import DARK, HOT, OUTSIDE, Radiance

Planes = NDArray[Any]


def average(radiance: Radiance, factor: int) -> Radiance:
    """Return the mean radiance of blocks of texels; rows and columns that fill no block are left out.

    Parameters
    ----------
    radiance : (light, y, x, 3)
        Radiance of texels. Defects are left out of the mean, and flag a block only where it has nothing else. A block
        is dark, or outside the mask, if all of it is, and saturated or shifted if any of it is.
    factor
        Texels along the side of a block.
    """
    if factor == 1:
        return radiance
    values, bits = blocks(radiance.value, factor), blocks(radiance.flags, factor)
    sound = (bits & HOT) == 0
    weight = np.where(sound.any((2, 4), keepdims=True), sound, True).astype(np.float32)
    mean = (weight * values).sum((2, 4)) / weight.sum((2, 4))
    every = np.bitwise_and.reduce(np.bitwise_and.reduce(bits, 4), 2) & np.uint8(HOT | DARK | OUTSIDE)
    some = np.bitwise_or.reduce(np.bitwise_or.reduce(np.where(sound, bits, 0), 4), 2) & ~np.uint8(HOT | DARK | OUTSIDE)
    return Radiance(mean.astype(np.float32), (every | some).astype(np.uint8))


def blocks(values: Planes, factor: int) -> Planes:
    """Return values (n, y, x, channel) as (n, row, y in block, column, x in block, channel)."""
    rows, columns = values.shape[1] // factor, values.shape[2] // factor
    whole = values[:, : rows * factor, : columns * factor]
    return whole.reshape(len(values), rows, factor, columns, factor, -1)
