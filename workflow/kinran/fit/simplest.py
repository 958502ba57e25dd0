"""The simplest lobes that explain each texel by itself: a map for people."""

import numpy as np
from numpy.typing import NDArray

from kinran import near, pictures
from kinran.fit import samples
from kinran.fit.candidates import CANDIDATES, DB_A_BYTE, Sampled, fit
from kinran.labels import LabelMap
from kinran.stack import Stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]

MAP_WIDTH = 320


def texel_map(
    stack: Stack, labels: LabelMap, second: LabelMap, sample: Sampled, error: float, threads: int
) -> NDArray[np.uint8]:
    """Simplest candidate (y, x) that explains each texel by itself, as an index into `CANDIDATES`.

    Parameters
    ----------
    sample
        What the regions' priors are learnt from.
    error
        Mean squared error of the fabric under lights left out: `simplest` takes a byte's cost from it.
    """
    priors = [sample.priors(candidate, threads) for candidate in CANDIDATES]
    result = np.zeros(labels.shape, np.uint8)
    lights = samples.training_lights(stack)
    for tile in samples.iterate(stack, stack.tiles()):
        y0, y1, x0, x1 = tile.box
        region, other = (samples.cut(m, tile.box).astype(np.intp) for m in (labels, second))
        found = np.zeros(len(region), np.uint8)
        for cell in near.cells(stack, tile.box, lights):
            at = cell.at
            part = tile.part(at, np.ones((len(at), 1), np.float32) if cell.factor is None else cell.factor)
            some = Sampled(part.T, part.W, cell.lights, region[at], other[at], sample.shown)
            said = [fit(c, some, cell.lights, p, threads, cell.slopes) for c, p in zip(CANDIDATES, priors, strict=True)]
            found[at] = simplest([left_out(some, T, c.numbers) for c, T in zip(CANDIDATES, said, strict=True)], error)
        result[y0:y1, x0:x1] = found.reshape(y1 - y0, x1 - x0)
    return result


def left_out(sample: Sampled, predicted: Single, numbers: int) -> Array:
    """Mean squared error (texel,) of displayed values under lights left out, from that under the fitted ones.

    Generalised cross-validation: n RSS / (n - k)² [Golub1979]; infinite for n ≤ k.
    """
    usable = sample.usable()
    off = np.where(usable, sample.shown(predicted) - sample.shown(sample.T), 0).astype(float)
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
    """The map with its legend."""
    grey = pictures.upright(np.array([40, 150, 250])[needs])
    shown = pictures.enlarge(np.repeat(grey[..., None], 3, 2), MAP_WIDTH)
    return pictures.sheet([[("texels that need no lobe (dark), one, two (light)", shown)]])
