"""Merged brackets at one sample a superpixel: R, the mean of both greens, B; never demosaiced."""

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from kinran.files import InputError
from kinran.radiance.bracket import DARK_SIGMA, estimate_rows
from kinran.radiance.calibration import Camera
from kinran.radiance.exposures import ratio, ratio_to, row_seconds
from kinran.radiance.shots import MISLABELLED, Bracket, site_black
from kinran.stack import DARK, HOT, SATURATED, SHIFTED

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]
Array = NDArray[np.float64]

STRIP = 64
"""Rows that are merged at a time, so that what is temporary stays small."""
FLICKER = 0.005
"""How well lamp and shutter repeat from frame to frame, relative."""
BLACK_ERROR = 0.05
"""How well the darkness of a frame is known, in counts."""
LEAST_SITES = 50
MOST_APART, MOST_APART_ENCODED = 0.05, 0.25
"""More samples than this share whose exposures disagree: a frame has moved. Photographs know their noise less well."""
MOST_BELOW_BLACK = 1e-3
OTHER_DEPTH = 1.03


class Superpixels(NamedTuple):
    """A merged bracket.

    Attributes
    ----------
    rate, sigma : (y, x, 3) float32
        Counts a second, and their standard deviation.
    flags : (y, x, 3) uint8
    """

    rate: Image
    sigma: Image
    flags: Flags


def merge_bracket(bracket: Bracket, camera: Camera) -> tuple[Image, Flags]:
    """`merge_sites` without σ, which follows from the value and the noise model."""
    merged = merge_sites(bracket, camera)
    return merged.rate, merged.flags


def merge_sites(bracket: Bracket, camera: Camera) -> Superpixels:
    """Merge a bracket to one sample a superpixel.

    Raises
    ------
    InputError
        An exposure is not the one that its name says, a frame has moved, or darkness or saturation are not those of
        the calibration.
    """
    black = site_black(bracket, camera.black, camera.masked)
    _check_depth(bracket, black, camera)
    seconds = shot_seconds(bracket, black, camera)
    height, width = bracket.planes.shape[2:]
    bad = np.zeros(bracket.planes.shape[1:], bool)
    bad[tuple(np.array(camera.bad, int).reshape(-1, 3).T)] = True
    merged = Superpixels(*(np.empty((height, width, 3), kind) for kind in (np.float32, np.float32, np.uint8)))
    below, apart = 0, 0
    for first in range(0, height, STRIP):
        rows = slice(first, min(first + STRIP, height))
        sites = estimate_rows(bracket.planes, black, seconds, camera.response, rows.start, rows.stop)
        counted = _combine(*sites, bad[:, rows], *(part[rows] for part in merged))
        below, apart = below + counted[0], apart + counted[1]
    _check(bracket, black, seconds, below / merged.rate.size, apart / merged.rate.size)
    if camera.bad:
        _fill(merged)
    return merged


@nb.njit(cache=True, error_model="numpy")  # type: ignore[untyped-decorator,unused-ignore]
def _combine(
    site: Image, spread: Image, apart: Flags, bad: Flags, rate: Image, sigma: Image, flags: Flags
) -> tuple[int, int]:
    """Sites (plane, y, x) to superpixels; of two greens the good ones, or both if both are bad.

    Returns
    -------
    below, moved : int
        Samples that are under darkness by five σ, and whose exposures disagree.
    """
    below, moved = 0, 0
    last = site.shape[0] - 1
    for y in range(rate.shape[0]):
        for x in range(rate.shape[1]):
            for c in range(3):
                a, b = (0, 0) if c == 0 else (last, last) if c == 2 else (1, last - 1)
                hot = bad[a, y, x] and bad[b, y, x]
                if not hot and bad[a, y, x]:
                    a = b
                if not hot and bad[b, y, x]:
                    b = a
                value = np.float32(0.5) * (site[a, y, x] + site[b, y, x])
                error = spread[a, y, x]
                if a != b:
                    error = np.float32(0.5) * np.sqrt(error * error + spread[b, y, x] * spread[b, y, x])
                bits = 0
                if np.isinf(error):
                    bits |= SATURATED
                elif value < np.float32(DARK_SIGMA) * error:
                    bits |= DARK
                if hot:
                    bits |= HOT
                if value < np.float32(-5) * error:
                    below += 1
                if apart[a, y, x] or apart[b, y, x]:
                    bits |= SHIFTED
                    moved += 1
                rate[y, x, c], sigma[y, x, c], flags[y, x, c] = value, error, bits
    return below, moved


def shot_seconds(bracket: Bracket, black: Array, camera: Camera) -> Array:
    """(exposure, y) times of the frames of this shot, lamp and shutter as they were; their log mean is calibrated.

    The calibrated ratio of two exposures is the prior, what this shot's pictures say the measurement.
    """
    exposures = [camera.exposure(nominal) for nominal in bracket.nominal_s]
    calibrated = np.array([exposure.seconds for exposure in exposures])
    rows = row_seconds(calibrated.tolist(), [exposure.curtain for exposure in exposures], bracket.planes.shape[2])
    seconds = calibrated.copy()
    for k in range(len(seconds) - 1):
        sums = ratio_to(bracket.planes, black, k, rows, camera.response.clip)
        found = ratio(sums, camera.response, BLACK_ERROR)
        off = 0.0
        if found.sites >= LEAST_SITES and found.noise < 1 / 30:
            off = found.value / (calibrated[k] / calibrated[k + 1]) - 1
            if abs(off) > MISLABELLED:
                raise mislabelled(bracket, black, k, 1 / (1 + off))
            off *= FLICKER**2 / (FLICKER**2 + found.noise**2)
        seconds[k + 1] = seconds[k] * (calibrated[k + 1] / calibrated[k]) / (1 + off)
    seconds *= np.exp(np.mean(np.log(calibrated / seconds)))
    return np.asarray(rows * (seconds / calibrated)[:, None])


def mislabelled(bracket: Bracket, black: Array, longer: int, times: float) -> InputError:
    """The error of an exposure that is so many times as bright beside the longer one as their times say.

    If the two agree in their histograms, though not site by site, the picture has moved.
    """
    expected = bracket.nominal_s[longer] / bracket.nominal_s[longer + 1]
    ranked = [np.sort(bracket.planes[k, 1].ravel()[::3]) - black[k, 1] for k in (longer, longer + 1)]
    use = (ranked[0] > 0.05 * ranked[0][-1]) & (ranked[0] < 0.8 * ranked[0][-1])
    alike = ranked[0][use].sum() / max(ranked[1][use].sum(), 1.0) / expected
    if use.any() and abs(alike - 1) < MISLABELLED:
        seconds = np.repeat(bracket.nominal_s[:, None], bracket.planes.shape[2], 1)
        return moved(bracket, _outlier(bracket, black, seconds))
    return InputError(
        f"{_file(bracket, longer + 1)}: is {times:.2f} times as bright beside {_file(bracket, longer).rsplit('/')[-1]}"
        " as their exposures say; they are mislabelled, of another depth, or the lamp failed: shoot them again"
    )


def moved(bracket: Bracket, exposure: int, share: float | None = None) -> InputError:
    """The error of a frame that does not agree with the others."""
    part = "" if share is None else f" in {share:.0%} of the picture"
    return InputError(
        f"{_file(bracket, exposure)}: does not agree with the other exposures{part}; something has moved:"
        " shoot the bracket again"
    )


def _file(bracket: Bracket, exposure: int) -> str:
    frames = bracket.frames or tuple(sorted(bracket.shot.frames, key=lambda frame: -frame.nominal_s))
    return str(frames[exposure].path) if frames else f"shot '{bracket.shot.shot}'"


def _check_depth(bracket: Bracket, black: Array, camera: Camera) -> None:
    """That counts end where the calibration says."""
    planes, full = bracket.planes[0], camera.response.saturation
    top = float(planes.max()) - float(black[0].mean())
    piled = float((planes[:, ::4, ::4] >= planes.max() * 0.999).mean())
    if top > OTHER_DEPTH * full or (piled > 0.02 and top < 0.95 * full and top > 0.02 * full):
        raise InputError(
            f"{_file(bracket, 0)}: counts end at {top:.0f} over black but those of the calibration at {full:.0f};"
            " it is of another ISO, bit depth or camera: shoot the calibration with the same settings"
        )


def _check(bracket: Bracket, black: Array, seconds: Array, below: float, apart: float) -> None:
    """That no more than these shares of the samples are under darkness, and disagree."""
    if below > MOST_BELOW_BLACK:
        raise InputError(
            f"{_file(bracket, 0)}: {below:.1%} of its samples are darker than darkness ({black.mean():.1f} counts);"
            " its black level is wrong: give RAW files as the camera wrote them"
        )
    if apart > (MOST_APART if bracket.bayer else MOST_APART_ENCODED):
        raise moved(bracket, _outlier(bracket, black, seconds), apart)


def _outlier(bracket: Bracket, black: Array, seconds: Array) -> int:
    """The exposure that differs most from what its neighbours say, on the green sites."""
    rates = (bracket.planes[:, 1] - black[:, 1, None, None]) / seconds[:, :, None]
    lit = bracket.planes[:, 1] < 0.9 * bracket.planes.max()
    middle = np.nanmedian(np.where(lit, rates, np.nan), axis=0, keepdims=True) if len(rates) else rates
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(lit & (middle > 0), np.abs(rates / middle - 1), np.nan)
    share = [float(np.nanmedian(one)) if np.isfinite(one).any() else 0.0 for one in off]
    return int(np.argmax(share))


def _fill(merged: Superpixels) -> None:
    """Give hot samples the mean of their good neighbours; the flag stays."""
    height, width, _ = merged.rate.shape
    for y, x, c in np.argwhere((merged.flags & HOT) > 0):
        near = np.s_[max(y - 1, 0) : min(y + 2, height), max(x - 1, 0) : min(x + 2, width), c]
        good = (merged.flags[near] & (HOT | SATURATED)) == 0
        if good.any():
            merged.rate[y, x, c] = merged.rate[near][good].mean()
