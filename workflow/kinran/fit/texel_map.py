"""The map of the simplest lobes that explain each texel by itself, for people."""

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.data.fabric import Fabric
from kinran.fit.candidates import CANDIDATES, DB_A_BYTE, Display
from kinran.fit.samples import Samples, read_samples

Array = NDArray[np.float64]
Single = NDArray[np.float32]

MAP_WIDTH = 320
"""Pixels across the picture."""


def texel_map(fabric: Fabric, sample: Samples, shown: Display, error: float, threads: int) -> NDArray[np.uint8]:
    """Simplest candidate (y, x) that explains each texel by itself, as an index into `CANDIDATES`.

    Parameters
    ----------
    sample
        Samples that the regions' priors are learned from.
    error
        Mean squared error of the fabric under lights left out, from which `simplest` takes the cost of a byte.
    """
    priors = [candidate.priors(sample, threads) for candidate in CANDIDATES]
    result = np.zeros(fabric.labels.shape, np.uint8)
    for box in fabric.stack.tiles():
        tile = read_samples(fabric, box)
        errors = []
        for candidate, given in zip(CANDIDATES, priors, strict=True):
            predicted = candidate.predicted(tile, given, tile.under, threads)
            errors.append(left_out(tile, predicted, shown, candidate.numbers))
        y0, y1, x0, x1 = box
        result[y0:y1, x0:x1] = simplest(errors, error).reshape(y1 - y0, x1 - x0)
    return result


def left_out(sample: Samples, predicted: Single, shown: Display, numbers: int) -> Array:
    """Mean squared error (texel,) of displayed values under lights left out, estimated from the fitted lights.

    The estimate is generalised cross-validation, n RSS / (n - k)² [Golub1979]; it is infinite for n ≤ k.
    """
    usable = sample.usable()
    off = np.where(usable, shown(predicted) - shown(sample.T), 0).astype(float)
    n = usable.sum((1, 2)).astype(float)
    free = np.maximum(n - numbers, 0)
    return np.where(free > 0, n * (off**2).sum((1, 2)) / np.where(free > 0, free, 1) ** 2, np.inf)


def simplest(errors: list[Array], error: float) -> NDArray[np.intp]:
    """Index (texel,) of the candidate that is worth its bytes, for the errors (texel,) of each of `CANDIDATES`.

    A byte in one of N texels has to gain the fabric, whose mean squared error is `error`, `DB_A_BYTE` / N decibels.
    """
    byte = DB_A_BYTE * np.log(10) / 10 * error
    return np.argmin([e + byte * c.size for e, c in zip(errors, CANDIDATES, strict=True)], axis=0)


def picture(needs: NDArray[np.uint8]) -> pictures.Picture:
    """Picture of the map, with its legend."""
    grey = pictures.upright(np.array([40, 150, 250])[needs])
    shown = pictures.enlarge(np.repeat(grey[..., None], 3, 2), MAP_WIDTH)
    return pictures.sheet([[("texels that need no lobe (dark), one, two (light)", shown)]])
