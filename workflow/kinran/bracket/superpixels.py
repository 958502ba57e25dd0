"""Merged brackets at one sample per superpixel: R, the mean of both greens, B; never demosaiced."""

from dataclasses import replace

import numba as nb
import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.black_level import site_black
from kinran.bracket.estimator import DARK_SIGMA, Merged, estimate_rows
from kinran.bracket.exposures import ratio, ratio_to, row_seconds
from kinran.bracket.shots import FULL, MISLABELLED, Bracket
from kinran.data.calibration import CalibratedCamera
from kinran.data.radiance import DARK, HOT, SATURATED, SHIFTED, Flags, Image, Radiance

Array = NDArray[np.float64]
Sites = NDArray[np.intp]

STRIP = 64
"""Rows that are merged at a time, to save memory."""
FLICKER = 0.005
"""Prior standard deviation, relative, of lamp and shutter from frame to frame: a choice."""
BLACK_ERROR = 0.05
"""Standard deviation of a frame's black level in counts: a choice."""
LEAST_SITES = 50
"""Fewest sites for a measured ratio of two exposures, whose noise has to be under a thirtieth, too: a choice."""
MOST_APART, MOST_APART_ENCODED = 0.05, 0.25
"""Share of samples with disagreeing exposures (RAW, photographs) above which a frame has moved: a choice. The noise of
photographs is known less well."""
MOST_BELOW_BLACK = 1e-3
"""Share of samples five σ under the black level above which that is wrong: noise alone gives one of three million."""
OTHER_DEPTH = 1.03
"""Factor over the calibrated saturation above which counts are of another ISO, bit depth or camera: a choice."""


def merge_bracket(bracket: Bracket, camera: CalibratedCamera) -> Radiance:
    """Merge a bracket as `merge_sites` does, without σ, which follows from the value and the noise model."""
    return _merge(bracket, camera, np.empty((STRIP, bracket.planes.shape[3], 3), np.float32))


def merge_sites(bracket: Bracket, camera: CalibratedCamera) -> Radiance:
    """Merge a bracket to one sample per superpixel (y, x, 3), in counts per second.

    Raises
    ------
    InputError
        An exposure is mislabelled, a frame has moved, or black level or saturation contradict the calibration.
    """
    sigma = np.empty((*bracket.planes.shape[2:], 3), np.float32)
    return replace(_merge(bracket, camera, sigma), sigma=sigma)


def _merge(bracket: Bracket, camera: CalibratedCamera, sigma: Image) -> Radiance:
    """Merge a bracket; σ is written to an array of all rows, or of one strip's where it is not used."""
    black = site_black(bracket, camera.black, camera.masked)
    _check_depth(bracket, black, camera)
    seconds = shot_seconds(bracket, black, camera)
    height, width = bracket.planes.shape[2:]
    bad = np.array(camera.bad, np.intp).reshape(-1, 3)
    rate, flags = np.empty((height, width, 3), np.float32), np.empty((height, width, 3), np.uint8)
    below, apart = 0, 0
    for first in range(0, height, STRIP):
        last, at = min(first + STRIP, height), first % len(sigma)
        sites = estimate_rows(bracket.planes, black, seconds, camera.response, first, last)
        _take_other_green(sites, bad[(bad[:, 1] >= first) & (bad[:, 1] < last)], first)
        counted = combine(*sites, rate[first:last], sigma[at : at + last - first], flags[first:last])
        below, apart = below + counted[0], apart + counted[1]
    _check(bracket, black, seconds, below / rate.size, apart / rate.size)
    hot = _hot_samples(bad, bracket.planes.shape[1])
    flags[tuple(hot.T)] |= HOT
    fill(rate, flags, hot)
    return Radiance(rate, flags)


def _hot_samples(bad: Sites, planes: int) -> Sites:
    """Return the samples (n, 3), as y, x, channel, without a good site: R, B, and green where both sites are bad."""
    green = bad[(bad[:, 0] > 0) & (bad[:, 0] < planes - 1)]
    places, count = np.unique(green[:, 1:], axis=0, return_counts=True)
    others = bad[(bad[:, 0] == 0) | (bad[:, 0] == planes - 1)]
    single = np.column_stack([others[:, 1:], np.where(others[:, 0] > 0, 2, 0)])
    both = places[count == planes - 2]
    return np.concatenate([single, np.column_stack([both, np.ones(len(both), np.intp)])])


def _take_other_green(sites: Merged, bad: Sites, first: int) -> None:
    """Replace a bad green site of a Bayer sensor by the other one, so that their mean has its value and its σ."""
    if len(sites.rate) != 4:
        return
    for plane in (1, 2):
        at = bad[bad[:, 0] == plane]
        here, there = (plane, at[:, 1] - first, at[:, 2]), (3 - plane, at[:, 1] - first, at[:, 2])
        sites.rate[here] = sites.rate[there]
        sites.sigma[here] = np.sqrt(np.float32(2)) * sites.sigma[there]
        sites.apart[here] = sites.apart[there]


@nb.njit(cache=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})  # type: ignore[untyped-decorator,unused-ignore]
def combine(site: Image, spread: Image, apart: Flags, rate: Image, sigma: Image, flags: Flags) -> tuple[int, int]:
    """Combine sites (plane, y, x) to superpixels in one loop without branches, which vectorises.

    Returns
    -------
    below, moved : int
        Number of samples five σ under the black level, and of samples whose exposures disagree.
    """
    last = site.shape[0] - 1
    half, far = np.float32(0.5), np.float32(-5)
    share = half if last == 3 else half**half  # the second green of photographs is the first one
    below, moved = 0, 0
    for y in range(rate.shape[0]):
        for x in range(rate.shape[1]):
            r, g, b = site[0, y, x], half * (site[1, y, x] + site[last - 1, y, x]), site[last, y, x]
            one, other = spread[1, y, x], spread[last - 1, y, x]
            error_r, error_b = spread[0, y, x], spread[last, y, x]
            error_g = share * np.sqrt(one * one + other * other)
            moved_r, moved_b = apart[0, y, x], apart[last, y, x]
            moved_g = apart[1, y, x] | apart[last - 1, y, x]
            rate[y, x, 0], rate[y, x, 1], rate[y, x, 2] = r, g, b
            sigma[y, x, 0], sigma[y, x, 1], sigma[y, x, 2] = error_r, error_g, error_b
            flags[y, x, 0] = _bits(r, error_r, moved_r)
            flags[y, x, 1] = _bits(g, error_g, moved_g)
            flags[y, x, 2] = _bits(b, error_b, moved_b)
            below += (r < far * error_r) + (g < far * error_g) + (b < far * error_b)
            moved += moved_r + moved_g + moved_b
    return below, moved


@nb.njit(inline="always")  # type: ignore[untyped-decorator,unused-ignore]
def _bits(value: np.float32, error: np.float32, apart: np.bool_) -> np.uint8:
    """Return the flags of a sample."""
    full = error == np.float32(np.inf)
    dark = (value < np.float32(DARK_SIGMA) * error) & (not full)
    return np.uint8(np.uint8(full) * SATURATED | np.uint8(dark) * DARK | np.uint8(apart) * SHIFTED)


def shot_seconds(bracket: Bracket, black: Array, camera: CalibratedCamera) -> Array:
    """Return the times (exposure, y) in seconds of a shot's frames, which absorb the flicker of lamp and shutter.

    The calibrated ratio of two exposures is the prior and the ratio of the shot's pictures the measurement, which
    are combined by their variances. The geometric mean of the times stays that of the calibrated ones.

    Raises
    ------
    InputError
        A ratio is more than `MISLABELLED` from the calibrated one.
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
    """Return the error of an exposure that is `times` as bright, relative to the longer one, as their times say.

    Where the histograms of the two agree, though not their sites, it is the error of a picture that has moved.
    """
    expected = bracket.nominal_s[longer] / bracket.nominal_s[longer + 1]
    ranked = [np.sort(bracket.planes[k, 1].ravel()[::3]) - black[k, 1].mean() for k in (longer, longer + 1)]
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
    """Return the error of a frame that disagrees with the others, in this share of the picture."""
    part = "" if share is None else f" in {share:.0%} of the picture"
    return InputError(
        f"{_file(bracket, exposure)}: does not agree with the other exposures{part}; something has moved:"
        " shoot the bracket again"
    )


def _file(bracket: Bracket, exposure: int) -> str:
    frames = bracket.frames or tuple(sorted(bracket.shot.frames, key=lambda frame: -frame.nominal_s))
    return str(frames[exposure].path) if frames else f"shot '{bracket.shot.shot}'"


def _check_depth(bracket: Bracket, black: Array, camera: CalibratedCamera) -> None:
    """Check that counts end at the calibrated saturation."""
    planes, full = bracket.planes[0], camera.response.saturation
    top = float(planes.max()) - float(black[0].mean())
    piled = planes[:, ::4, ::4] >= planes.max() * 0.999
    # (a flat part of a photograph may well have one code)
    many = bracket.bayer and piled.mean() > 0.02 and piled.sum() >= LEAST_SITES
    deeper = top > OTHER_DEPTH * full and (bracket.bayer or full < 0.8 * FULL)  # else white itself is the last code
    if deeper or (many and 0.02 * full < top < 0.95 * full):
        raise InputError(
            f"{_file(bracket, 0)}: counts end at {top:.0f} over black but those of the calibration at {full:.0f};"
            " it is of another ISO, bit depth or camera: shoot the calibration with the same settings"
        )


def _check(bracket: Bracket, black: Array, seconds: Array, below: float, apart: float) -> None:
    """Check the shares of samples under the black level, and of those whose exposures disagree."""
    if below > MOST_BELOW_BLACK:
        raise InputError(
            f"{_file(bracket, 0)}: {below:.1%} of its samples are darker than darkness ({black.mean():.1f} counts);"
            " its black level is wrong: give RAW files as the camera wrote them"
        )
    if apart > (MOST_APART if bracket.bayer else MOST_APART_ENCODED):
        raise moved(bracket, _outlier(bracket, black, seconds), apart)


def _outlier(bracket: Bracket, black: Array, seconds: Array) -> int:
    """Return the exposure that differs most from the median of all, on the green sites."""
    rates = (bracket.planes[:, 1] - black[:, 1, :, None]) / seconds[:, :, None]
    lit = bracket.planes[:, 1] < 0.9 * bracket.planes.max()
    some = lit.any(0)
    rates, lit = rates[:, some], lit[:, some]
    middle = np.nanmedian(np.where(lit, rates, np.nan), axis=0, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.where(lit & (middle > 0), np.abs(rates / middle - 1), np.nan)
    share = [float(np.nanmedian(one)) if np.isfinite(one).any() else 0.0 for one in off]
    return int(np.argmax(share))


@nb.njit(cache=True)  # type: ignore[untyped-decorator,unused-ignore]
def fill(rate: Image, flags: Flags, hot: Sites) -> None:
    """Replace hot samples (n, 3) by the mean of their good neighbours; the flag stays."""
    height, width, _ = rate.shape
    for k in range(len(hot)):
        y, x, c = hot[k]
        total, good = 0.0, 0
        for v in range(max(y - 1, 0), min(y + 2, height)):
            for u in range(max(x - 1, 0), min(x + 2, width)):
                if flags[v, u, c] & (HOT | SATURATED) == 0:
                    total += rate[v, u, c]
                    good += 1
        if good:
            rate[y, x, c] = total / good
