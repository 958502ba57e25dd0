"""Black levels of brackets: under the sensor's mask where it has one, else as the files state them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.bracket.shots import Bracket

LIT = 1.0
"""Counts by which a border has to brighten from the shortest to the longest exposure to be lit: a choice. The level
of a masked one wanders by a third of a count from frame to frame."""
SIGNIFICANT = 5
"""Standard errors by which the border of a lit sensor brightens with the exposure time: a choice."""
APART = 1 / 64
"""Share of the range by which the level under the mask may differ from the stated one: more, and either is no black
level. Sensors whose rows differ by kind were found 3 counts of 14 bits from it, which is 1/5000."""


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


def site_black(bracket: Bracket, black: tuple[float, ...], masked: bool) -> NDArray[np.float64]:
    """Return the black levels (exposure, plane) in counts of each frame and kind of site.

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
    if not masked:
        return np.broadcast_to(np.array(black), (len(bracket.nominal_s), len(black))).copy()
    if bracket.mask is None:
        raise InputError(f"shot '{bracket.shot.shot}': its frames have no masked border, but the dark ones had")
    return np.array(black) + bracket.mask
