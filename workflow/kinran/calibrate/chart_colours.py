"""Colours from the picture of a chart: its place, the patches that can be used, and the matrix fitted to them."""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.calibrate import chart_place, colour_chart
from kinran.calibrate.glare import estimate_glare
from kinran.data.calibration import Patch
from kinran.data.radiance import HOT, SATURATED, Radiance

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_DELTA_E = 6.0
"""Median leave-one-out ΔE00 above which a picture shows no chart: real patches in three narrow bands of light have 5.1
on average (``kinran bench merge --data``)."""
LEAST_PATCHES = 15
"""Fewest patches for a fit: over twice the six terms of a root polynomial."""
ROOT_GAIN, LEAST_GAIN = 0.9, 0.1
"""Share of the matrix's leave-one-out ΔE00, and difference to it, under which a root polynomial is used: a choice."""

MOST_OF_A_PATCH = 10.0
"""ΔE00 beyond which a patch counts no more when readings of a chart are compared: a highlight is on one patch, and a
wrong reading moves all. A choice."""
SAME_VEIL = 0.3
"""Share by which veils differ that are worth another look at all patches: those of sound grey patches, each left out in
turn, agree to a seventh on a real chart. A choice."""
MOST_UNEVEN = 0.2
"""Change of the light from one side of the chart to the other that is refused. A choice."""
LEAST_LIGHT = 0.05
"""Least mean reflectance of a patch that tells how much light falls on it: what glare leaves is most of a darker one. A
choice."""
TURNS = 4
"""Iterations of fitting the matrix and the white balance in turn: a choice."""


class Found(NamedTuple):
    """A chart in a picture.

    Attributes
    ----------
    colours : (24, 3) float
        Mean RGB of each patch.
    seen : (24,) bool
        Whether each patch is in the picture and, but for a tenth, neither saturated nor on a defect.
    error
        Median leave-one-out ΔE00 of the patches under the fitted matrix; infinite where too few are seen.
    place
        Corners of the chart in the picture.
    """

    colours: Array
    seen: Mask
    error: float
    place: chart_place.Place


@dataclass(frozen=True)
class Chart:
    """Result of a colour chart; attributes are those of `Calibration`, and the glare of `CalibratedCamera`."""

    matrix: Array
    chart: tuple[Patch, ...]
    root_polynomial: tuple[tuple[float, ...], ...] | None
    glare: float
    generation: str

    @property
    def patches(self) -> tuple[int, ...]:
        """Indices of the patches that are used."""
        return tuple(k for k, patch in enumerate(self.chart) if not patch.left_out)

    @property
    def delta_e(self) -> tuple[float, ...]:
        """Leave-one-out ΔE00 of the patches that are used, under the matrix."""
        return tuple(self.chart[k].delta_e for k in self.patches)


class Judged(NamedTuple):
    """Patches under one reading of a chart: its generation, and the veil that its grey patches tell of.

    Attributes
    ----------
    colours : (24, 3) float
        White-balanced colours of the patches without the veil.
    balance : (3,) float
        White balance.
    reference : (24, 3) float
        Reference colours.
    used : (24,) bool
        Patches that are seen and do not contradict the others.
    errors : (24,) float
        Leave-one-out ΔE00 of each patch.
    glare
        Veil, over the mean light of the picture.
    generation
        Generation of the chart; empty for reference colours under a lamp.
    """

    colours: Array
    balance: Array
    reference: Array
    used: Mask
    errors: Array
    glare: float
    generation: str

    def score(self, seen: Mask) -> float:
        """Mean error of the patches that are seen, of which none counts more than `MOST_OF_A_PATCH`."""
        return float(np.minimum(self.errors[seen], MOST_OF_A_PATCH).mean())


def fit_colours(picture: Radiance, shot: str, corners: str = "", lamp: str = "", greys: bool = False) -> Chart:
    """Fit the colours of a chart.

    The generation of the chart and the veil of glare are those under which its patches agree best: a highlight on a
    dark patch looks like glare, until one sees what that would do to all others.

    Parameters
    ----------
    picture : (y, x, 3)
        Picture of the chart, in light relative to white; on any scale where `greys`.
    shot
        Name of the shot, for the error.
    corners, lamp
        Corners and lamp, as `parse_corners` and `references` take them.
    greys
        Whether the chart's grey patches define white.

    Raises
    ------
    InputError
        The chart is not found, too few patches can be used, their colours are not those of the chart, or the light on
        it is uneven.
    """
    first, *others = ("",) if lamp else colour_chart.GENERATIONS
    reference = colour_chart.references(lamp)
    colours, seen, error, place = find_chart(picture, reference, corners, greys)
    if seen.sum() < LEAST_PATCHES:
        raise InputError(f"shot '{shot}': only {seen.sum()} of 24 patches can be used; shoot the chart again")
    if error > MOST_DELTA_E:
        raise InputError(
            f"shot '{shot}': its patches are ΔE00 {error:.1f} from the chart's; let the chart fill the picture, or give"
            f" its corners{', and develop it without a tone curve' if greys else ''}"
        )
    if place.mirrored:
        raise InputError(f"shot '{shot}': its chart is mirrored; give pictures as the camera takes them")
    read = partial(_judged, colours, picture.value.mean((0, 1), dtype=float), seen, greys)
    judged = [read(reference, first), *(read(colour_chart.references("", name), name) for name in others)]
    best = min((one for readings in judged for one in readings), key=lambda one: one.score(seen))
    errors = best.errors[best.used]
    if np.median(errors) > MOST_DELTA_E:
        raise InputError(
            f"shot '{shot}': its patches disagree by ΔE00 {np.median(errors):.1f}; light it evenly, once more"
        )
    _check_light(best, place, shot)
    return _fitted(best, picture, place, seen)


def _judged(colours: Array, mean: Array, seen: Mask, greys: bool, reference: Array, generation: str) -> list[Judged]:
    """Return readings of a chart of one generation: with the veil of all grey patches, without one of them, or none."""
    balance = _greys_as_white(colours, reference, seen) if greys else np.ones(3)
    colours, mean = colours * balance, mean * balance
    grey = np.flatnonzero(seen)[np.flatnonzero(seen) >= colour_chart.GREYS.start]
    veils = [
        estimate_glare(colours[some].mean(1), reference[some].mean(1), float(mean.mean()))
        for some in (grey, *(grey[grey != one] for one in grey))
    ]
    readings = []
    for glare in [veils[0], *(one for one in dict.fromkeys([*veils[1:], 0.0]) if _other(one, veils[0]))]:
        clear = colours - glare / (1 + glare) * mean
        used = seen.copy()
        used[seen] = ~colour_chart.outliers(clear[seen], reference[seen])
        errors = colour_chart.held_out_errors(clear, reference, used, 1)
        readings.append(Judged(clear, balance, reference, used, errors, glare, generation))
    return readings


def _other(glare: float, known: float) -> bool:
    """Return whether a veil differs from one that is tried already."""
    return abs(glare - known) > SAME_VEIL * max(glare, known)


def _check_light(judged: Judged, place: chart_place.Place, shot: str) -> None:
    """Check that the light falls evenly on the patches, by a plane through the logarithms of their luminance.

    Raises
    ------
    InputError
        From one side of the chart to the other the light changes by more than `MOST_UNEVEN`.
    """
    used = np.flatnonzero(judged.used & (judged.reference.mean(1) > LEAST_LIGHT))
    matrix = colour_chart.fit_matrix(judged.colours[used], judged.reference[used])
    level = colour_chart.scale(judged.colours[used], judged.reference[used])
    seen = colour_chart.apply(matrix, level * judged.colours[used]).mean(1)
    rows, columns = np.divmod(used, colour_chart.COLUMNS)
    across = np.stack([columns / (colour_chart.COLUMNS - 1), rows / (colour_chart.ROWS - 1), np.ones(len(used))], 1)
    step = np.linalg.lstsq(across, np.log(np.maximum(seen, 1e-6) / judged.reference[used].mean(1)), rcond=None)[0]
    uneven = float(np.expm1(np.abs(step[:2]).sum()))
    if uneven > MOST_UNEVEN:
        side = "patches of its first row" if abs(step[1]) > abs(step[0]) else "patches of its first column"
        more = "less" if step[int(abs(step[1]) > abs(step[0]))] > 0 else "more"
        raise InputError(
            f"shot '{shot}': the light on its chart is uneven, by {uneven:.0%} over the chart, {more} on the {side};"
            " move the lamp away, or the chart to the middle of the light"
        )


def _fitted(best: Judged, picture: Radiance, place: chart_place.Place, seen: Mask) -> Chart:
    """Return the matrix, the root polynomial if it is better, and all patches, under the best reading of a chart."""
    colours, reference, used, linear = best.colours, best.reference, best.used, best.errors
    bent = colour_chart.held_out_errors(colours, reference, used, 2)
    matrix = colour_chart.fit_matrix(colours[used], reference[used])
    better = bent[used].mean() < min(ROOT_GAIN * linear[used].mean(), linear[used].mean() - LEAST_GAIN)
    polynomial = colour_chart.fit_matrix(colours[used], reference[used], 2) if better else None
    shown = colour_chart.apply(matrix, colour_chart.scale(colours[used], reference[used]) * colours)
    reasons = _reasons(picture, place, seen, used)
    patches = [
        Patch(_triple(a), _triple(b), round(float(e), 4), round(float(f), 4), why)
        for a, b, e, f, why in zip(shown, reference, linear, bent, reasons, strict=True)
    ]
    root = None if polynomial is None else polynomial * colour_chart.expand(best.balance[None], 2)
    rows = None if root is None else tuple(map(tuple, root.tolist()))
    return Chart(matrix * best.balance, tuple(patches), rows, best.glare, best.generation)


def _greys_as_white(colours: Array, reference: Array, seen: Mask) -> Array:
    """Return the white balance (3,) that makes the grey patches neutral but for their own tint in this camera."""
    balance = _grey_balance(colours, reference, seen)
    for _ in range(TURNS):
        matrix = colour_chart.fit_matrix((colours * balance)[seen], reference[seen])
        balance = _grey_balance(colours, reference @ np.linalg.inv(matrix).T, seen)
    return balance


def _grey_balance(colours: Array, expected: Array, seen: Mask) -> Array:
    """Return the factors (3,), relative to green, that scale the grey patches that are seen to the `expected` ones."""
    grey = seen & (np.arange(len(seen)) >= colour_chart.GREYS.start)
    level = (colours[grey] * expected[grey]).sum(0) / np.maximum((colours[grey] ** 2).sum(0), 1e-12)
    return np.asarray(level / level[1]) if grey.any() else np.ones(3)


def _reasons(picture: Radiance, place: chart_place.Place, seen: Mask, used: Mask) -> list[str]:
    """Return why each patch is left out; empty where it is used."""

    def free_of(bits: int) -> Mask:
        return chart_place.patches(picture.value, ~picture.texels_with(bits), place)[1]

    conditions = [used, seen, ~free_of(0), ~free_of(SATURATED)]
    reasons = ["", "contradicted by the others", "outside the picture", "saturated"]
    return [str(why) for why in np.select(conditions, reasons, "on a defect of the sensor")]


def find_chart(picture: Radiance, reference: Array, corners: str, greys: bool = False) -> Found:
    """Find a chart, and the orientation that fits best.

    Without corners, the chart is tried as one that fills the picture, then where the detector finds one.
    """
    height, width = picture.value.shape[:2]
    place = chart_place.parse_corners(corners, height) if corners else chart_place.whole(height, width)
    best = _best_way_up(picture, reference, place, greys)
    if best.error >= MOST_DELTA_E and not corners:
        seen = chart_place.find(picture.value)
        if seen is not None:
            best = min(best, _best_way_up(picture, reference, seen, greys), key=lambda found: found.error)
    return best


def _best_way_up(picture: Radiance, reference: Array, place: chart_place.Place, greys: bool) -> Found:
    usable = ~picture.texels_with(SATURATED | HOT)
    found = []
    for quarters in range(4):
        turned = place.turned(quarters)
        colours, seen = chart_place.patches(picture.value, usable, turned)
        enough = seen.sum() >= LEAST_PATCHES
        balanced = colours * _grey_balance(colours, reference, seen) if greys else colours
        errors = colour_chart.leave_one_out(balanced[seen], reference[seen]) if enough else np.array([np.inf])
        found.append(Found(colours, seen, float(np.median(errors)), turned))
    return min(found, key=lambda one: one.error)


def _triple(colour: Array) -> tuple[float, float, float]:
    r, g, b = (round(float(part), 5) for part in colour)
    return r, g, b
