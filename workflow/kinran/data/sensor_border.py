"""The border of a sensor above and left of its picture: its level for each kind of site, and its drift along rows."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LEAST_MASK = 64
"""Fewest masked sites of a kind on which its black level is measured: their mean has 1/8 of the read noise."""
LEAST_LINE = 8
"""Fewest sites of a kind in a line of the border that has a mean of its own: a choice."""
ALIKE = 0.5
"""Difference in counts of two lines' means, beyond their noise, up to which they are alike: a choice."""
FAR = 6
"""Standard deviations from the median over which a site is hot, and a row none of the others' kind: noise alone gives
one of a thousand million."""
SURE = 5
"""Standard errors by which the power of a band of frequencies exceeds that of noise where rows drift: a choice. Of 300
frames without drift, 2 % had such a band."""


class Border(NamedTuple):
    """The border of one frame.

    Attributes
    ----------
    levels : (4,) float
        Mean of each kind of site in counts.
    drift : (row,) float
        What the level of each row of the picture, top row first, differs by in counts; 0 where the border beside does
        not tell it from noise.
    """

    levels: Array
    drift: Array


def read_border(
    full: NDArray[np.uint16], corner: tuple[int, int], rows: tuple[int, int], sites: Sequence[tuple[int, int]]
) -> Border | None:
    """Return what the border above and left of the lit part tells; None where there is none.

    Lines at the rim of a sensor, and those beside the picture, are often neither dark nor lit. So a line counts only
    where its mean is that of the others. Whether the border is dark at all, a bracket alone can tell.

    Parameters
    ----------
    full : (row, column) uint16
        Counts of the whole sensor.
    corner
        First row and column of its lit part.
    rows
        First row of the picture, and its number of rows.
    sites
        Row and column, 0 or 1, of the first site of each kind on the sensor.
    """
    top, left = corner
    levels = []
    beside: tuple[list[Array], list[Array]] = ([], [])
    for row, column in sites:
        above = full[row:top:2, column::2]
        columns = full[top + (row - top) % 2 :: 2, column:left:2].T
        lines = [line for part in (above, columns) for line in part if line.size >= LEAST_LINE]
        alike = _alike(lines)
        used = np.concatenate([line for line, use in zip(lines, alike, strict=True) if use] or [np.empty(0)])
        if used.size < LEAST_MASK:
            return None
        levels.append(_middle(used))
        first, count = rows
        start = first + (row - first) % 2
        if columns.shape[1] >= LEAST_LINE:
            dark = 2 * np.flatnonzero(alike[len(lines) - len(columns) :]) + column
            beside[start - first].append(np.subtract(full[start : first + count : 2][:, dark], levels[-1], dtype=float))
    return Border(np.array(levels), _drift([np.hstack(parts) for parts in beside if parts], rows[1]))


def _alike(lines: Sequence[NDArray[np.uint16]]) -> NDArray[np.bool_]:
    """Return which lines have the mean that most have."""
    if not lines:
        return np.zeros(0, bool)
    middles = np.array([np.median(line) for line in lines])
    means = np.array([_middle(line) for line in lines])
    deviation = 1.4826 * np.median(np.abs(np.concatenate(lines) - np.median(np.concatenate(lines)))) + 0.3
    allowed = 6 * deviation / np.sqrt([line.size for line in lines]) + ALIKE
    return np.asarray(np.abs(means - np.median(middles)) <= allowed)


def _middle(counts: NDArray[np.uint16]) -> float:
    """Return the mean of counts without hot sites."""
    away = np.abs(counts - np.median(counts))
    return float(counts[away <= FAR * 1.4826 * np.median(away) + 1].mean())


def _drift(halves: Sequence[Array], rows: int) -> Array:
    """Return the drift (row,) from the counts over their kind's level (row, site) of even and of odd rows."""
    if len(halves) < 2 or min(half.shape[1] for half in halves) < LEAST_LINE:
        return np.zeros(rows)
    means, noise = np.empty(rows), 0.0
    for parity, half in enumerate(halves):
        away = half - np.median(half, 1, keepdims=True)
        dark = np.abs(away) <= FAR * 1.4826 * np.median(np.abs(away)) + 1
        count = np.maximum(dark.sum(1), 1)
        mean = (half * dark).sum(1) / count
        noise += float((np.square(half - mean[:, None]) * dark).sum() / (count - 1).sum() / count.mean()) / 2
        means[parity::2] = mean
    spread = 1.4826 * float(np.median(np.abs(means - np.median(means))))
    return smoothed(np.clip(means, np.median(means) - FAR * spread, np.median(means) + FAR * spread), noise)


def smoothed(means: Array, noise: float) -> Array:
    """Return the part of the rows' means (row,) that exceeds their noise.

    It is the Wiener filter of their cosine transform: in bands of an octave, what the power has over that of noise is
    the drift's, and coefficients are shrunk by its share. Where the power does not exceed noise by `SURE` standard
    errors, nothing is left.

    Parameters
    ----------
    means : (row,)
        Mean of each row in counts.
    noise
        Variance of a mean by the noise of its sites.
    """
    from scipy.fft import dct, idct

    coefficients = dct(means, norm="ortho")
    kept = np.zeros_like(coefficients)
    first = 0
    while first < len(means):
        band = slice(first, max(2 * first, 1))
        size = len(coefficients[band])
        power = float(np.square(coefficients[band]).mean())
        if power > noise * (1 + SURE * np.sqrt(2 / size)):
            kept[band] = coefficients[band] * (1 - noise / power)
        first = band.stop
    return np.asarray(idct(kept, norm="ortho"))
