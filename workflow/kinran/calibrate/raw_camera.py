"""Properties of a RAW camera, measured on its frames: black level, saturation, gain, shutter times, bad sites."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.black_level import site_black
from kinran.bracket.exposures import discrepancy, measure, third_stop
from kinran.bracket.shots import MISLABELLED, Bracket, light_of
from kinran.data.calibration import Exposure, Response

Array = NDArray[np.float64]

HOT_SIGMA = 6.0
"""Standard deviations in a dark frame above which a site is hot: noise alone gives one of a thousand million."""
MOST_BAD = 0.01
"""Share of hot or dead sites above which the lens was not covered: a choice."""


def measure_dark(dark: Bracket, masked: bool) -> tuple[tuple[float, float, float, float], float, NDArray[np.bool_]]:
    """Measure the black level on a bracket of dark frames, whose border may be `masked`.

    Returns
    -------
    black : (4,) float
        Black level of R, G1, G2, B in counts, relative to the mask's where there is one.
    read : float
        Read noise in counts.
    hot : (4, y, x) bool
        Hot sites.

    Raises
    ------
    InputError
        The frames are not dark, or their read noise is not plausible.
    """
    offset = site_black(dark, (0.0,) * 4, masked)
    counts = dark.planes - offset[..., None]
    middle = np.median(counts[-1])
    spread = 1.4826 * np.median(np.abs(counts[-1] - middle)) + 0.5
    within = np.abs(counts - middle) < HOT_SIGMA * spread
    if within.mean() < 1 - MOST_BAD:
        raise InputError(f"shot '{dark.shot.shot}': is not dark; cover the lens and shoot it again")
    kept = np.where(within, counts, np.nan)
    black = np.nanmean(kept, axis=(0, 2, 3))
    read = float(np.nanstd(kept[-1] - black[:, None, None]))
    if not 0.1 < read < 200:
        raise InputError(f"shot '{dark.shot.shot}': a read noise of {read:.2f} counts is not plausible; shoot it again")
    hot = (counts - black[:, None, None] > HOT_SIGMA * read).any(0)
    a, b, c, d = (float(value) for value in black)
    return (a, b, c, d), read, hot


def measure_saturation(white: Bracket, levels: Array) -> float:
    """Measure the saturation in counts over black: where the longest exposure of the white plate piles up.

    The level that files state is often wrong; it is used where nothing is saturated.

    Parameters
    ----------
    white
        Bracket of the white plate.
    levels : (exposure, plane, y)
        Its black levels in counts.

    Raises
    ------
    InputError
        The saturation is over the level that the file states.
    """
    counts = white.planes[0] - levels[0, ..., None]
    top = counts.max()
    piled = counts[counts > 0.99 * top]
    stated = white.white - float(levels[0].mean())
    saturation = float(np.percentile(piled, 1)) if len(piled) > 0.05 * counts.size else stated
    if not 0 < saturation <= 1.02 * stated:
        raise InputError(
            f"shot '{white.shot.shot}': saturates at {saturation:.0f} counts over black, but the file says"
            f" {stated:.0f}; is it of the same camera?"
        )
    return saturation


def photon_transfer(white: Bracket, black: Array, saturation: float, read: float) -> tuple[float, float]:
    """Measure counts per electron and PRNU on the differences of neighbouring green sites on the white plate.

    Their variance is 2 (gain · m + read² + PRNU² m²) for a mean of m counts.

    Parameters
    ----------
    white
        Bracket of the white plate.
    black : (exposure, plane, y)
        Black levels in counts.
    saturation, read
        Saturation over black, and read noise, in counts.

    Raises
    ------
    InputError
        No exposure is well lit, or the gain is not plausible.
    """
    rows, variances, weights = [], [], []
    for k in range(len(white.nominal_s)):
        green = light_of(white, black, k)
        mean = float(green.mean())
        if not 5 * read < mean < 0.95 * saturation or (green > 0.97 * saturation).mean() > 0.01:
            continue
        difference = green[0] - green[1]
        limit = 4 * 1.4826 * np.median(np.abs(difference - np.median(difference)))
        kept = difference[np.abs(difference - np.median(difference)) < limit]
        variance = float(kept.var()) - 2 * read**2
        rows.append([2 * mean, 2 * mean**2])
        variances.append(variance)
        weights.append(1 / max(variance, read**2))
    w = np.array(weights)
    if not rows:
        raise InputError(f"shot '{white.shot.shot}': no exposure is lit but under saturation; add shorter ones")
    A, b = np.array(rows) * w[:, None], np.array(variances) * w
    gain, pattern = np.linalg.lstsq(A, b, rcond=None)[0] if len(rows) > 1 else (0.0, -1.0)
    prnu = float(np.sqrt(max(pattern, 0.0)))
    if pattern < 0:
        gain = float(A[:, 0] @ b / (A[:, 0] @ A[:, 0]))
    if not 1e-3 < gain < 50:
        raise InputError(
            f"shot '{white.shot.shot}': {gain:.4f} counts per electron are not plausible;"
            " put the plate into the picture and shoot it again"
        )
    return float(gain), prnu


def measure_exposures(lit: Sequence[Bracket], blacks: Sequence[Array], response: Response) -> tuple[Exposure, ...]:
    """Measure true shutter times: ratios of neighbouring exposures from the pictures, the longest at its third stop.

    Raises
    ------
    InputError
        A ratio is more than 10 % from that of the third stops.
    """
    nominal = [float(value) for value in lit[0].nominal_s]
    prior = [third_stop(value) for value in nominal]
    exposures = measure([bracket.planes for bracket in lit], blacks, nominal, prior, response)
    for k in range(len(nominal) - 1):
        off = discrepancy(exposures, k)
        if abs(off) > MISLABELLED:
            expected = prior[k] / prior[k + 1]
            raise InputError(
                f"exposures {nominal[k]:g} s and {nominal[k + 1]:g} s: the pictures say a ratio of"
                f" {(1 + off) * expected:.3f}, the dial {expected:.3f}; frames are mislabelled or the lamp failed:"
                " shoot them again"
            )
    return exposures


def dead_sites(white: Bracket, black: Array, saturation: float) -> NDArray[np.bool_]:
    """Return the dead sites (4, y, x): those with less than half of their plane's median on the white plate."""
    for k in range(len(white.nominal_s)):
        counts = white.planes[k] - black[k, ..., None]
        middle = np.median(counts, axis=(1, 2), keepdims=True)
        if middle.max() < 0.9 * saturation:
            return np.asarray(counts < 0.5 * middle)
    return np.zeros(white.planes.shape[1:], bool)
