"""Pictures of a large fabric, made smaller by the means of blocks while its tiles are gone through."""

import numpy as np
from numpy.typing import NDArray

from kinran.data.radiance_stack import Box

Images = NDArray[np.float32]


class BlockMeans:
    """Means of blocks of `step` × `step` texels of images (image, y, x, channel), which come in tiles.

    Parameters
    ----------
    shape
        Number of images, their height, width and channels.
    step
        Side of a block; blocks at the upper and right edge may be smaller.
    """

    def __init__(self, shape: tuple[int, int, int, int], step: int) -> None:
        images, height, width, channels = shape
        self._step = step
        self._texels = np.outer(*(np.bincount(np.arange(side) // step) for side in (height, width)))
        self._sum = np.zeros((images, *self._texels.shape, channels), np.float32)

    def add(self, box: Box, images: Images) -> None:
        """Add the images of a tile (y0, y1, x0, x1), whatever blocks it cuts."""
        rows, columns = np.arange(*box[:2]) // self._step, np.arange(*box[2:]) // self._step
        (top, left), (y, x) = zip(*(_firsts(blocks) for blocks in (rows, columns)), strict=True)
        self._sum[:, y[:, None], x] += np.add.reduceat(np.add.reduceat(images, top, 1), left, 2)

    def images(self) -> Images:
        """Return the means (image, y, x, channel)."""
        return np.asarray(self._sum / self._texels[..., None], np.float32)


def _firsts(blocks: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where each block begins in a sorted list of them, and its number."""
    first = np.flatnonzero(np.diff(blocks, prepend=-1))
    return first, blocks[first]
