"""Which frame belongs to which exposure, by what the frames say of themselves and never by their names or places."""

import math
from collections.abc import Mapping, Sequence

from kinran.rig.camera import FrameFacts

STEP = 1 / 6
"""Stops by which EXIF may differ from what was asked: half of the smallest step of a camera, a third of a stop. A
camera says 1/30 s and means 1/32 s (0.09 stops); 1/13 s for 1/12.7 s is the like."""


def same_setting(said: float, asked: float, stops: float = STEP) -> bool:
    """Return whether two exposure times, or ISO numbers, are nominally one; 0 in either is unknown and fits."""
    return not said or not asked or abs(math.log2(said / asked)) < stops


def same_aperture(said: float, asked: float) -> bool:
    """Return whether two f-numbers are nominally one: a stop is a factor √2; 0 in either is unknown and fits."""
    return same_setting(said, asked, STEP / 2)


def complaint(facts: FrameFacts, exposure_s: float, iso: float, aperture: float) -> str:
    """Return what is wrong with a frame's settings; empty where it is what was asked."""
    if not facts.exposure_s or not same_setting(facts.exposure_s, exposure_s):
        return f"its exposure is {shown(facts.exposure_s)}"
    if not same_setting(facts.iso, iso):
        return f"its ISO is {facts.iso:g} instead of {iso:g}"
    if not same_aperture(facts.aperture, aperture):
        return f"its aperture is f/{facts.aperture:.3g} instead of f/{aperture:.3g}"
    return ""


def match(
    wanted: Mapping[int, float],
    found: Sequence[FrameFacts],
    iso: float = 0.0,
    aperture: float = 0.0,
    since: float = 0.0,
) -> tuple[dict[int, int], dict[int, str]]:
    """Give each exposure the one frame that can be its own.

    Parameters
    ----------
    wanted
        Nominal exposure times in seconds by their places in the bracket.
    found
        What the frames say.
    iso, aperture
        Settings that all frames must have; 0 for any.
    since
        Time of the camera's clock before which an earlier exposure was taken.

    Returns
    -------
    own : dict of int to int
        Number of the frame, by the exposure's place. An exposure that two frames fit has none: which is its own would
        be a guess.
    others : dict of int to str
        The numbers of all other frames, and why each has no place.
    """
    fitting: dict[int, list[int]] = {place: [] for place in wanted}
    others: dict[int, str] = {}
    for number, facts in enumerate(found):
        reasons = {k: complaint(facts, seconds, iso, aperture) for k, seconds in wanted.items()}
        places = [k for k, reason in reasons.items() if not reason]
        if facts.taken and facts.taken < since:
            others[number] = "it was taken for an earlier exposure, and landed late"
        elif len(places) == 1:
            fitting[places[0]].append(number)
        else:
            settings = [reason for reason in reasons.values() if "exposure" not in reason]
            others[number] = next(iter(settings or reasons.values()), "nothing was asked for")
    for numbers in fitting.values():
        if len(numbers) > 1:
            others |= dict.fromkeys(numbers, "another frame has the same exposure")
    return {k: numbers[0] for k, numbers in fitting.items() if len(numbers) == 1}, others


def shown(seconds: float) -> str:
    """Return an exposure time as a camera names it."""
    if not seconds:
        return "not stated"
    return f"{seconds:.3g} s" if seconds >= 0.3 else f"1/{1 / seconds:.0f} s"
