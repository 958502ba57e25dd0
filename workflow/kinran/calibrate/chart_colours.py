"""Colours from the picture of a chart: its place, the patches that can be used, and the matrix fitted to them."""

from dataclasses import dataclass
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

    @property
    def patches(self) -> tuple[int, ...]:
        """Indices of the patches that are used."""
        return tuple(k for k, patch in enumerate(self.chart) if not patch.left_out)

    @property
    def delta_e(self) -> tuple[float, ...]:
        """Leave-one-out ΔE00 of the patches that are used, under the matrix."""
        return tuple(self.chart[k].delta_e for k in self.patches)


def fit_colours(picture: Radiance, shot: str, corners: str = "", lamp: str = "", greys: bool = False) -> Chart:
    """Fit the colours of a chart.

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
        The chart is not found, too few patches can be used, or their colours are not those of the chart.
    """
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
    balance = _greys_as_white(colours, reference, seen) if greys else np.ones(3)
    colours, light = colours * balance, picture.value * balance.astype(np.float32)
    grey = np.flatnonzero(seen)[np.flatnonzero(seen) >= colour_chart.GREYS.start]
    glare = estimate_glare(colours[grey].mean(1), reference[grey].mean(1), float(light.mean()))
    colours = colours - glare / (1 + glare) * light.mean((0, 1), dtype=float)
    used = seen.copy()
    used[seen] = ~colour_chart.outliers(colours[seen], reference[seen])
    linear, bent = (colour_chart.held_out_errors(colours, reference, used, degree) for degree in (1, 2))
    matrix = colour_chart.fit_matrix(colours[used], reference[used])
    better = bent[used].mean() < min(ROOT_GAIN * linear[used].mean(), linear[used].mean() - LEAST_GAIN)
    polynomial = colour_chart.fit_matrix(colours[used], reference[used], 2) if better else None
    shown = colour_chart.apply(matrix, colour_chart.scale(colours[used], reference[used]) * colours)
    reasons = _reasons(picture, place, seen, used)
    patches = [
        Patch(_triple(a), _triple(b), round(float(e), 4), round(float(f), 4), why)
        for a, b, e, f, why in zip(shown, reference, linear, bent, reasons, strict=True)
    ]
    root = None if polynomial is None else polynomial * colour_chart.expand(balance[None], 2)
    return Chart(matrix * balance, tuple(patches), None if root is None else tuple(map(tuple, root.tolist())), glare)


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
