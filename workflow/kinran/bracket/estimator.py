"""The estimator: light of each sensor site from its counts at several exposures, before any demosaic.

It makes two passes over the counts of one site, without a temporary picture. The first predicts the signal from the
shortest exposure upwards; the second takes the mean with weights from the *predicted* variance (a weight from the noisy
value itself is biased in the dark), tapered to zero under saturation. The χ² of the residuals then tells whether the
exposures agree.
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from kinran.data.calibration import Response

Image = NDArray[np.float32]
Counts = NDArray[np.uint16]
Array = NDArray[np.float64]

TAPER = 0.92
"""Share of saturation from which the weight of an exposure falls to 0, so that no step shows where it ends. 0.80 costs
30 to 45 % of RMSE in the tenth of a decade under saturation, 0.92 under 1 % (on the synthetic camera of ``kinran bench
merge``)."""
DARK_SIGMA = 3.0
"""Number of standard deviations under which a value is flagged as dark: noise alone rarely exceeds it."""
GUARD = 2
"""Pixels around a saturated one of a photograph that are left out of exposure ratios: demosaicing reaches so far."""
CHANCE = 1e-7
"""Probability that noise alone makes the exposures of a site disagree: one site of ten megapixels."""


class Merged(NamedTuple):
    """A merged bracket.

    Attributes
    ----------
    rate : (...) float32
        Counts per second. Where every exposure is saturated, the rate of the shortest: a lower bound.
    sigma : (...) float32
        Standard deviation of `rate`; infinite where every exposure is saturated.
    apart : (...) bool
        Whether the exposures disagree by more than their noise, since something moved.
    """

    rate: Image
    sigma: Image
    apart: NDArray[np.bool_]


class _Sensor(NamedTuple):
    """Sensor for the compiled loop.

    Attributes
    ----------
    clip, gain
        Attributes of `Response`.
    read, coding
        Variances: squares of the attributes of `Response`.
    limit
        χ² above which the exposures of a site disagree.
    """

    clip: np.float32
    gain: np.float32
    read: np.float32
    coding: np.float32
    limit: np.float32


def estimate(counts: Counts, black: Array, seconds: Array, response: Response) -> Merged:
    """Merge a bracket.

    Parameters
    ----------
    counts : (exposure, ...) uint16
        Counts of the sites.
    black : (exposure,) float
        Black level of each frame in counts.
    seconds : (exposure,) float
        True shutter times in seconds, in any order.
    response
        Response of the sensor.
    """
    order = np.argsort(-seconds, kind="stable")
    planes = np.ascontiguousarray(counts[order]).reshape(len(seconds), 1, 1, -1)
    merged = estimate_rows(planes, black[order, None, None], seconds[order, None], response, 0, 1)
    shape = counts.shape[1:]
    return Merged(merged.rate.reshape(shape), merged.sigma.reshape(shape), merged.apart.reshape(shape))


def estimate_rows(planes: Counts, black: Array, seconds: Array, response: Response, first: int, last: int) -> Merged:
    """Merge rows `first` to `last` of all planes of a bracket, the longest exposure first.

    Parameters
    ----------
    planes : (exposure, plane, y, x) uint16
        Counts of the sites.
    black : (exposure, plane, y) float
        Black levels of each row in counts.
    seconds : (exposure, y) float
        True shutter times of each row in seconds.
    response
        Response of the sensor.
    first, last
        First row, and the one after the last.

    Returns
    -------
    Merged
        Merged sites (plane, last - first, x).
    """
    from scipy.special import chdtri

    shape = (planes.shape[1], last - first, planes.shape[3])
    merged = Merged(np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.bool_))
    sensor = _Sensor(
        np.float32(response.clip),
        np.float32(response.gain),
        np.float32(response.read**2),
        np.float32(response.coding**2),
        np.float32(chdtri(len(planes) - 1, CHANCE) if len(planes) > 1 else np.inf),
    )
    _kernel(len(planes))(planes, black.astype(np.float32), seconds.astype(np.float32), sensor, first, merged)
    return merged


@cache
def _kernel(n: int) -> Callable[..., None]:
    """Compile the loop of `estimate_rows` for n exposures: with n known, the compiler unrolls and vectorises it."""
    last = n - 1

    def merge(counts: Counts, black: Image, seconds: Image, sensor: _Sensor, start: int, merged: Merged) -> None:
        clip, gain, read, coding, limit = sensor
        rate, sigma, apart = merged
        zero, one, tiny = np.float32(0), np.float32(1), np.float32(1e-30)
        width = one / (clip * np.float32(1 - TAPER))
        knee = clip * np.float32((1 + TAPER) / 2)
        for k in range(rate.shape[0]):
            for row in range(rate.shape[1]):
                y = start + row
                level = black[:, k, y]
                for x in range(rate.shape[2]):
                    shortest = np.float32(counts[last, k, y, x]) - level[last]
                    unsaturated = one if shortest < clip else zero
                    signal, time = unsaturated * shortest, unsaturated * seconds[last, y]
                    for j in range(last):
                        i = last - 1 - j
                        value = np.float32(counts[i, k, y, x]) - level[i]
                        below = (max(signal, zero) * seconds[i, y] < knee * time) & (value < knee)
                        weight = one if below else zero
                        signal += weight * value
                        time += weight * seconds[i, y]
                    predicted = max(signal, zero) / (time + tiny)
                    top, bottom, apartness = zero, zero, zero
                    for i in range(n):
                        value = np.float32(counts[i, k, y, x]) - level[i]
                        expected = predicted * seconds[i, y]
                        weight = unsaturated
                        if i < last:
                            weight = min(max((clip - max(expected, value)) * width, zero), one)
                        information = weight / (expected * (gain + coding * expected) + read)
                        top += information * seconds[i, y] * value
                        bottom += information * seconds[i, y] * seconds[i, y]
                        apartness += information * (value - expected) * (value - expected)
                    seen = bottom > zero
                    inverse = one / (bottom + tiny)
                    rate[k, row, x] = top * inverse if seen else shortest / seconds[last, y]
                    sigma[k, row, x] = np.sqrt(inverse) if seen else np.float32(np.inf)
                    apart[k, row, x] = apartness > limit

    compiled: Any = nb.njit(cache=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})
    return compiled(merge)  # type: ignore[no-any-return]


def ratio_sums(planes: Counts, black: Array, longer: int, clip: float) -> Array:
    """Return sums of counts whose ratio is that of neighbouring exposures.

    They are unbiased: pixels are chosen by one green site and measured on the other.

    Parameters
    ----------
    planes : (exposure, plane, y, x) uint16
        Longest exposure first; four planes of a Bayer sensor, or three of photographs, whose only green does both.
    black : (exposure, plane, y) float
        Black levels of each row in counts.
    longer
        Index of the exposure that is compared with the next shorter one.
    clip
        Saturation in counts over black.

    Returns
    -------
    (y, 3) float
        For each row: counts over black, in the longer exposure, of the sites that are well lit in it; those of the
        same sites in the shorter exposure; number of these sites.
    """
    sums = np.zeros((planes.shape[2], 3))
    bayer = planes.shape[1] == 4
    for chosen, measured in ((1, 2), (2, 1)) if bayer else ((1, 1),):
        a, b = black[longer, [chosen, measured]].mean(1)
        levels = np.ceil([a + 0.05 * clip, a + 0.8 * clip, b + 0.97 * clip]).clip(0, 65535).astype(np.uint16)
        choosing = planes[longer, chosen] if bayer else guarded(planes[longer, chosen], float(levels[2]))
        found = np.zeros((planes.shape[2], 3), np.int64)
        _ratio_sums(choosing, planes[longer, measured], planes[longer + 1, measured], levels, found)
        sums += found
        sums[:, :2] -= found[:, 2:] * black[[longer, longer + 1], measured].T
    return sums


def guarded(counts: Counts, full: float) -> Counts:
    """Return counts (y, x) that are 0 within `GUARD` of those from `full` up, which demosaicing or scaling mixes."""
    from scipy.ndimage import maximum_filter

    return np.where(maximum_filter(counts, 2 * GUARD + 1) < full, counts, np.uint16(0))


@nb.njit(cache=True)  # type: ignore[untyped-decorator,unused-ignore]
def _ratio_sums(chosen: Counts, longer: Counts, shorter: Counts, levels: Counts, sums: NDArray[np.int64]) -> None:
    """Sum over the sites with low ≤ chosen < high and longer < full, in whole numbers, which vectorises."""
    low, high, full = levels
    for y in range(chosen.shape[0]):
        top, bottom, sites = np.uint32(0), np.uint32(0), np.uint32(0)  # they hold a row of 65,536 counts of 16 bits
        for x in range(chosen.shape[1]):
            use = np.uint32((chosen[y, x] >= low) & (chosen[y, x] < high) & (longer[y, x] < full))
            top += use * np.uint32(longer[y, x])
            bottom += use * np.uint32(shorter[y, x])
            sites += use
        sums[y, 0], sums[y, 1], sums[y, 2] = top, bottom, sites
