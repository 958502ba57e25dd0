"""Black levels of brackets: under the sensor's mask where it has one, else as files state them and exposures agree."""

import logging
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.shots import Bracket

Array = NDArray[np.float64]

log = logging.getLogger(__name__)

LIT = 1.0
"""Counts by which a border has to brighten from the shortest to the longest exposure to be lit: a choice. The level
of a masked one wanders by a third of a count from frame to frame."""
SIGNIFICANT = 5
"""Standard errors by which the border of a lit sensor brightens with the exposure time: a choice."""
APART = 1 / 64
"""Share of the range by which the level under the mask may differ from the stated one: more, and either is no black
level. Sensors whose rows differ by kind were found 3 counts of 14 bits from it, which is 1/5000."""
CHOSEN_BY = (1, 2, 1, 2)
"""Planes by whose counts the sites of R, G1, G2, B are put into bins: a choice by a site's own noise would bias it."""
BINS, LEAST_IN_BIN, MOST_SITES = 24, 30, 300_000
"""Bins of the level, fewest sites of one, and most sites of a frame that are used, as for its noise: choices."""
UNEVEN = 2e-3
"""Relative error by which the sites of a bin represent the ratio of two exposures: a choice."""
MOST_CUT = 0.005
"""Largest share of counts at 0 in a bin that is used, since clipping at 0 makes its mean too high: a choice."""


def masked_border(brackets: Sequence[Bracket]) -> bool:
    """Return whether the borders of a camera's frames are dark, so that they tell the black level of each frame.

    Nothing in a file says so for certain. But a border that is not masked brightens with the exposure time.

    Raises
    ------
    InputError
        A border is dark, and far from the black level that the file states.
    """
    if any(bracket.mask is None for bracket in brackets):
        return False
    for bracket in brackets:
        assert bracket.mask is not None
        if _brightens(bracket.mask.mean(1), bracket.nominal_s):
            return False
    for bracket in brackets:
        assert bracket.mask is not None
        off = bracket.mask - bracket.black
        if np.abs(off).max() > APART * (bracket.white - bracket.black.mean()):
            k = int(np.abs(off).max(1).argmax())
            raise InputError(
                f"{bracket.frames[k].path}: the sensor's dark border has {bracket.mask[k].mean():.1f} counts, but the"
                f" file states a black level of {bracket.black[k].mean():.1f}; give RAW files as the camera wrote them"
            )
    return True


def _brightens(levels: NDArray[np.float64], seconds: NDArray[np.float64]) -> bool:
    """Return whether levels grow with the exposure time by more than they scatter."""
    if len(levels) < 2:
        return False
    slope, start = np.polyfit(seconds, levels, 1)
    rise = slope * float(np.ptp(seconds))
    scatter = np.sqrt(np.sum((levels - start - slope * seconds) ** 2) / max(len(levels) - 2, 1))
    error = scatter / np.sqrt(np.sum((seconds - seconds.mean()) ** 2)) * np.ptp(seconds)
    return bool(rise > max(LIT, SIGNIFICANT * error))


def fitted_black(brackets: Sequence[Bracket], blacks: Sequence[Array], seconds: Array, clip: float) -> Array | None:
    """Return the black levels (plane,) on which exposures agree, where they contradict those that files state.

    Parameters are those of `fitted_shift`; the result is None where there is no contradiction beyond `SIGNIFICANT`
    standard errors.

    Raises
    ------
    InputError
        The levels differ by more than `APART`.
    """
    shift, error = fitted_shift(brackets, blacks, seconds, clip)
    wrong = np.abs(shift) > SIGNIFICANT * error
    if not wrong.any():
        return None
    stated = blacks[0][0].mean(1)
    level = np.asarray(stated + np.where(wrong, shift, 0.0))
    first = brackets[0].frames[0].path
    if np.abs(level - stated).max() > APART * clip:
        raise InputError(
            f"{first}: states a black level of {stated.mean():.1f} counts, but its exposures agree on"
            f" {level.mean():.1f}; give RAW files as the camera wrote them"
        )
    log.warning(
        "%s: states black levels of %s counts, but the exposures agree on %s; the pictures are believed",
        first,
        _few(stated),
        _few(level),
    )
    return level


def _few(levels: Array) -> str:
    """Return levels in a word or four."""
    words = [f"{level:.2f}" for level in levels]
    return words[0] if len(set(words)) == 1 else ", ".join(words)


def fitted_shift(
    brackets: Sequence[Bracket], blacks: Sequence[Array], seconds: Array, clip: float
) -> tuple[Array, Array]:
    """Return what black levels have to be raised by so that the ratio of exposures does not depend on the level.

    A count is b + r t, with the rate r of light. So the shorter of two exposures is q times the longer one, plus
    (1 - q) b: the levels' means lie on a line whose intercept tells b, and whose slope, q, is left free.

    Parameters
    ----------
    brackets
        Brackets of a Bayer sensor with the same exposures, longest first.
    blacks
        Their black levels (exposure, plane, y) in counts.
    seconds : (exposure, y) float
        True times in seconds.
    clip
        Saturation in counts over black.

    Returns
    -------
    shift, error : (plane,) float
        Counts, and their standard deviation; infinite where nothing tells.
    """
    top, bottom = np.zeros(4), np.zeros(4)
    for bracket, black in zip(brackets, blacks, strict=True):
        step = max(1, round((bracket.planes[0].size / MOST_SITES) ** 0.5))
        some, level = bracket.planes[:, :, ::step, ::step], black[:, :, ::step, None]
        for k in range(len(some) - 1):
            ratio = (seconds[k + 1] / seconds[k])[::step, None]
            for plane, chosen in enumerate(CHOSEN_BY):
                longer = (some[k, plane] - level[k, plane]) * ratio
                shorter = some[k + 1, plane] - level[k + 1, plane]
                cut = np.minimum(some[k, plane], some[k + 1, plane]) == 0
                full = some[k, plane] - level[k, plane] > 0.9 * clip
                order = np.argsort(some[k, chosen], axis=None, kind="stable")
                rest, slope, variance = _line(longer.ravel(), shorter.ravel(), (cut, full), order)
                share = 1 - float(ratio.mean()) * (1 + slope)
                top[plane] += rest * share / variance
                bottom[plane] += share**2 / variance
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bottom > 0, top / bottom, 0.0), 1 / np.sqrt(bottom)


def _line(
    longer: Array, shorter: Array, bad: Sequence[NDArray[np.bool_]], order: NDArray[np.intp]
) -> tuple[float, float, float]:
    """Return intercept and slope of the line of what the shorter exposure exceeds the longer one by, and a variance.

    The variance is that of the intercept; it is infinite where fewer than three bins tell.
    """
    cut, full = (one.ravel() for one in bad)
    parts = [part for part in np.array_split(order, BINS) if len(part) >= LEAST_IN_BIN]
    parts = [part for part in parts if cut[part].mean() <= MOST_CUT and not full[part].any()]
    if len(parts) < 3:
        return 0.0, 0.0, np.inf
    level = np.array([longer[part].mean() for part in parts])
    off = np.array([(shorter[part] - longer[part]).mean() for part in parts])
    noise = np.array([(shorter[part] - longer[part]).var() / len(part) for part in parts]) + (UNEVEN * level) ** 2
    across = np.stack([np.ones_like(level), level], 1) / np.sqrt(noise)[:, None]
    line, _, rank, _ = np.linalg.lstsq(across, off / np.sqrt(noise), rcond=None)
    if rank < 2:
        return 0.0, 0.0, np.inf
    misfit = float(np.square(off / np.sqrt(noise) - across @ line).sum()) / (len(parts) - 2)
    return float(line[0]), float(line[1]), float(np.linalg.inv(across.T @ across)[0, 0]) * max(misfit, 1.0)


def site_black(bracket: Bracket, black: tuple[float, ...], masked: bool) -> NDArray[np.float64]:
    """Return the black levels (exposure, plane, y) in counts of each frame, kind of site and row.

    Parameters
    ----------
    bracket
        The bracket.
    black : (plane,)
        Calibrated black levels, relative to the mean under the mask if `masked`.
    masked
        Whether the camera's frames have a masked border.

    Raises
    ------
    InputError
        The camera's frames have a masked border, and those of the bracket have none.
    """
    levels = np.broadcast_to(np.array(black)[:, None], bracket.planes.shape[:3])
    if not masked:
        return levels.copy()
    if bracket.mask is None:
        raise InputError(f"shot '{bracket.shot.shot}': its frames have no masked border, but the dark ones had")
    under = levels + bracket.mask[..., None]
    return under if bracket.drift is None else under + bracket.drift
