"""Shutter times: the third stops that nominal times stand for, and true times from the pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.estimator import ratio_sums
from kinran.data.calibration import Exposure, Response

Array = NDArray[np.float64]
Counts = NDArray[np.uint16]

DIAL = (
    *(30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3.2, 2.5, 2, 1.6, 1.3, 1, 0.8, 0.6, 0.5, 0.4, 0.3),
    *(1 / n for n in (4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400, 500)),
    *(1 / n for n in (640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000)),
)
"""Nominal times of a camera's dial in seconds, in thirds of a stop."""
NAMED = 0.006
"""Relative difference within which a time counts as one of the dial: a choice."""
DEGREE = 3
"""Degree of the polynomial for the travel of the curtains."""
BANDS = 16
"""Bands of rows that the polynomial is fitted to: four for each coefficient."""
LEAST_IN_BAND = 50
"""Fewest lit sites of a band that is used: a choice."""
LEAST_SITES = 100
"""Fewest sites for a measured ratio of two exposures, whose noise has to be under 1 %, too: a choice."""


@dataclass(frozen=True)
class Ratio:
    """Measured ratio of an exposure to the next shorter one.

    Attributes
    ----------
    value
        Ratio; NaN without a site.
    noise
        Relative standard deviation of the ratio by photon noise, read noise and the error of the black level.
    sites
        Number of sites that it is measured on.
    """

    value: float
    noise: float
    sites: int


def third_stop(nominal: float) -> float:
    """Return the third stop in seconds that a time of the dial stands for, a power of 2^(1/3): 1/25.4 s for 1/25 s.

    A time that is not on the dial is returned as it is.
    """
    if min(abs(nominal / time - 1) for time in DIAL) > NAMED:
        return nominal
    return float(2.0 ** (round(3 * math.log2(nominal)) / 3))


def parse_times(text: str) -> list[float]:
    """Parse times in seconds such as ``1/25,1/100,0.004``.

    Raises
    ------
    InputError
        A word is not a time over 0 s.
    """
    times = []
    for word in text.split(","):
        try:
            times.append(float(Fraction(word.strip())))
        except (ValueError, ZeroDivisionError):
            raise InputError(f"times '{text}': '{word}' is no time; give seconds such as 1/25,1/100,0.004") from None
        if not 0 < times[-1] < 1e5:
            raise InputError(f"times '{text}': '{word}' is not a time over 0 s")
    return times


def curtain(coefficients: Sequence[float], rows: int) -> Array:
    """Return the exposure (rows,) of each row relative to the mean, from the bottom up.

    Parameters
    ----------
    coefficients
        Legendre coefficients of degree 1, 2, …; none for a shutter that exposes all rows alike.
    rows
        Number of rows.
    """
    at = (np.arange(rows) + 0.5) / rows * 2 - 1
    return np.asarray(1 + legendre.legval(at, [0.0, *coefficients]), float)


def ratio(sums: Array, response: Response, black_error: float) -> Ratio:
    """Return the ratio of two exposures from the sums (y, 3) of `ratio_sums` over all rows.

    `black_error` is the standard deviation of the black level in counts.
    """
    top, bottom, sites = (float(value) for value in sums.sum(0))
    if bottom <= 0:
        return Ratio(math.nan, math.inf, int(sites))
    noise = math.hypot(math.sqrt(bottom * response.gain + sites * response.read**2), sites * black_error)
    return Ratio(top / bottom, noise / bottom, int(sites))


def curtain_of(sums: Array, response: Response) -> tuple[float, ...]:
    """Fit the curtain of a shorter exposure relative to that of the longer one.

    A polynomial is fitted to the ratio of both exposures in bands of rows by least squares. The weight of a band
    follows from its noise and 0.2 %, the assumed error by which its lit sites represent it.

    Parameters
    ----------
    sums : (y, 3) float
        Sums of `ratio_sums`.
    response
        Response of the sensor.

    Returns
    -------
    tuple of float
        Legendre coefficients of degree 1, 2, 3; none where the curtain is not significant.
    """
    rows = len(sums)
    bands = min(BANDS, rows // 4)
    if bands <= DEGREE + 2:
        return ()
    cuts = np.linspace(0, rows, bands + 1).round().astype(int)
    top, bottom, sites = np.add.reduceat(sums, cuts[:-1]).T
    lit = (sites >= LEAST_IN_BAND) & (bottom > 0)
    if lit.sum() <= DEGREE + 2:
        return ()
    relative = (bottom[lit] / top[lit]) / (bottom[lit].sum() / top[lit].sum())
    noise = np.hypot(np.sqrt(bottom[lit] * response.gain + sites[lit] * response.read**2) / bottom[lit], 2e-3)
    at = (cuts[:-1] + cuts[1:])[lit] / rows - 1
    basis = legendre.legvander(at, DEGREE) / noise[:, None]
    fitted = np.linalg.lstsq(basis, relative / noise, rcond=None)[0]
    before, after = (np.square((relative - m) / noise).sum() for m in (1.0, basis @ fitted * noise))
    if before - after < 30:  # χ² of three degrees of freedom: a chance of one in a million
        return ()
    return tuple(float(c) for c in fitted[1:] / fitted[0])


def row_seconds(seconds: Sequence[float], curtains: Sequence[Sequence[float]], rows: int) -> Array:
    """Return the true times (exposure, rows) in seconds of each row of the sensor."""
    return np.asarray([time * curtain(shape, rows) for time, shape in zip(seconds, curtains, strict=True)], float)


def ratio_to(planes: Counts, black: Array, longer: int, rows: Array, clip: float) -> Array:
    """Return the sums (y, 3) of `ratio_sums`, with the shorter exposure corrected to the longer one's curtain.

    Parameters
    ----------
    planes, black, longer, clip
        Parameters of `ratio_sums`.
    rows : (exposure, y)
        Times of `row_seconds`.
    """
    sums = ratio_sums(planes, black, longer, clip)
    shape = rows[longer] / rows[longer].mean() / (rows[longer + 1] / rows[longer + 1].mean())
    sums[:, 1] *= shape
    return sums


def measure(
    planes: Sequence[Counts],
    blacks: Sequence[Array],
    nominal: Sequence[float],
    prior: Sequence[float],
    response: Response,
) -> tuple[Exposure, ...]:
    """Measure the true shutter times of brackets with the same exposures.

    The longest time is its prior; the others follow from the ratios of neighbouring exposures.

    Parameters
    ----------
    planes, blacks
        Counts and black levels of each bracket, as `ratio_sums` takes them.
    nominal, prior
        Nominal times and their third stops in seconds, longest first.
    response
        Response of the sensor.
    """
    rows, count = planes[0].shape[2], len(nominal)
    exposures = [Exposure(nominal[0], prior[0], prior[0], 0)]
    for k in range(count - 1):
        longer = exposures[-1]
        shape = longer.curtain
        for _ in range(2):
            level = row_seconds([1.0] * count, [e.curtain for e in exposures] + [shape] * (count - 1 - k), rows)
            parts = [ratio_to(p, black, k, level, response.clip) for p, black in zip(planes, blacks, strict=True)]
            sums = np.asarray(sum(parts))
            more = curtain_of(sums, response) if planes[0].shape[1] == 4 else ()
            if not more:
                break
            shape = tuple(float(c) for c in np.add(more, [*shape, *[0.0] * DEGREE][:DEGREE]))
        found = ratio(sums, response, 0.0)
        known = found.sites >= LEAST_SITES and found.noise < 0.01
        seconds = longer.seconds / (found.value if known else prior[k] / prior[k + 1])
        exposures.append(Exposure(nominal[k + 1], prior[k + 1], seconds, found.sites if known else 0, shape))
    return tuple(exposures)


def discrepancy(exposures: Sequence[Exposure], longer: int) -> float:
    """Return the relative error of the prior ratio of an exposure to the next shorter one, by the pictures."""
    a, b = exposures[longer], exposures[longer + 1]
    return a.seconds / b.seconds / (a.prior_s / b.prior_s) - 1
