"""Shutter times: what a camera means by 1/25 s, and what the pictures say of it."""

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
"""Times in thirds of a stop, as cameras name them."""
NAMED = 0.006
"""A time that is as close, relative, to one of the dial is meant by it."""
DEGREE = 3
"""Degree of the polynomial for the travel of the curtains."""
BANDS = 16
"""Bands of rows that the polynomial is fitted to: four for each of its coefficients."""
LEAST_IN_BAND = 50
"""Lit sites that a band needs to tell its ratio."""
LEAST_SITES = 100
"""Sites that are enough to tell the ratio of two exposures, if its noise is under 1 %."""


@dataclass(frozen=True)
class Ratio:
    """How much longer an exposure is than the next shorter one.

    Attributes
    ----------
    value
        Estimate; NaN where no site tells.
    noise
        Its relative standard deviation, by photon and read noise and by the darkness.
    sites
        How many sites tell.
    """

    value: float
    noise: float
    sites: int


def third_stop(nominal: float) -> float:
    """The power of 2^(1/3) seconds that a camera means by a time of its dial: 1/25.4 s for 1/25 s.

    A time that no dial has is what it is.
    """
    if min(abs(nominal / time - 1) for time in DIAL) > NAMED:
        return nominal
    return float(2.0 ** (round(3 * math.log2(nominal)) / 3))


def parse_times(text: str) -> list[float]:
    """Seconds of a list such as ``1/25,1/100,0.004``.

    Raises
    ------
    InputError
        A word is no time over 0 s.
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
    """(rows,) exposure of each row relative to the mean, from the bottom up, of its Legendre coefficients.

    Parameters
    ----------
    coefficients
        Legendre coefficients of degree 1, 2, …; none for a shutter that exposes all rows alike.
    rows
        Their number.
    """
    at = (np.arange(rows) + 0.5) / rows * 2 - 1
    return np.asarray(1 + legendre.legval(at, [0.0, *coefficients]), float)


def ratio(sums: Array, response: Response, black_error: float) -> Ratio:
    """Ratio of two exposures from the sums of `ratio_sums`, all rows taken together."""
    top, bottom, sites = (float(value) for value in sums.sum(0))
    if bottom <= 0:
        return Ratio(math.nan, math.inf, int(sites))
    noise = math.hypot(math.sqrt(bottom * response.gain + sites * response.read**2), sites * black_error)
    return Ratio(top / bottom, noise / bottom, int(sites))


def curtain_of(sums: Array, response: Response) -> tuple[float, ...]:
    """Legendre coefficients of a shorter exposure's curtain relative to the longer one's; none if it shows none.

    The ratio of both exposures in bands of rows, by weighted least squares. Each band counts by its noise, or by
    0.2 %, which is how well the lit sites of a band represent it.

    Parameters
    ----------
    sums : (y, 3) float
        What `ratio_sums` returns.
    response
        Response of the sensor.
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
    if before - after < 30:  # χ² of three degrees of freedom: chance gives this once in a million
        return ()
    return tuple(float(c) for c in fitted[1:] / fitted[0])


def row_seconds(seconds: Sequence[float], curtains: Sequence[Sequence[float]], rows: int) -> Array:
    """(exposure, rows) true times of each row of the sensor."""
    return np.asarray([time * curtain(shape, rows) for time, shape in zip(seconds, curtains, strict=True)], float)


def ratio_to(planes: Counts, black: Array, longer: int, rows: Array, clip: float) -> Array:
    """`ratio_sums` in which the shorter exposure is brought to the longer one's curtain.

    Parameters
    ----------
    rows : (exposure, y)
        `row_seconds`.
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
    """True shutter times of brackets with the same exposures: the longest as its prior, the others by their ratios.

    Parameters
    ----------
    planes, blacks
        Counts and black of each bracket, as `ratio_sums` takes them.
    nominal, prior
        Times, longest first: as named, and as meant.
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
    """Relative error of the times that are meant, of this exposure and the next shorter one, by their pictures."""
    a, b = exposures[longer], exposures[longer + 1]
    return a.seconds / b.seconds / (a.prior_s / b.prior_s) - 1
