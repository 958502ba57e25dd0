"""Calibrate the camera, the lamp and the colours of a capture.

From the shots of the group ``calibration`` (a covered lens, a white plate at θ = 0, a colour chart at 45°)
and from the repeats of θ = 0 in the manifests that are given. Every value is checked for plausibility: what
is wrong here is wrong in everything that follows. Photographs need no more than their encoding.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import colour_chart
from kinran.bracket import Response
from kinran.calibration import Calibration, Camera, write_calibration
from kinran.encoding import parse
from kinran.files import InputError
from kinran.frames import direction
from kinran.lamp import irradiance, level
from kinran.photographs import parse_crop
from kinran.photographs import read as read_photograph
from kinran.plans import Plan, read_plan
from kinran.sensor import (
    MOST_BAD,
    dead_sites,
    measure_dark,
    measure_exposures,
    measure_saturation,
    photon_transfer,
)
from kinran.shots import Bracket, Taken, merge_bracket, read_bracket, read_manifest, site_black
from kinran.stack import HOT, SATURATED

Array = NDArray[np.float64]

MOST_DELTA_E = 6.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--plan", type=Path, required=True, help="plan of the capture")
    help_ = "manifests of the calibration and of other groups, then the calibration to write (.json)"
    # OUT comes last, as in every stage, where argparse takes it for one more manifest
    parser.add_argument("--manifests", type=Path, nargs="+", required=True, metavar="MANIFEST", help=help_)


def main(args: argparse.Namespace) -> None:
    """Write the calibration."""
    *manifests, out = args.manifests
    if not manifests:
        raise InputError(f"{out}: is the only file given; give manifests, then the calibration to write")
    plan = read_plan(args.plan)
    shots = [shot for path in manifests for shot in read_manifest(path, plan)]
    calibration = calibrate_photographs(plan, shots) if plan.encoding else calibrate(plan, shots)
    write_calibration(out, calibration)
    print(_summary(calibration), file=sys.stderr)


def calibrate_photographs(plan: Plan, shots: Sequence[Taken]) -> Calibration:
    """Calibration of photographs: their size, and linear Rec. 709 for their colours.

    Raises
    ------
    InputError
        The first one cannot be read.
    """
    if not shots or not shots[0].frames:
        raise InputError(f"plan of {plan.fabric}: no photograph is listed; ingest the folder again")
    encoding = plan.encoding or ""
    first = read_photograph(shots[0].frames[0].path, parse(encoding), parse_crop(plan.crop)).light
    height, width = first.shape[:2]
    matrix, name = _rows(colour_chart.REC709_TO_ACESCG), "linear Rec. 709"
    return Calibration(plan.fabric, plan.sha256, height, width, encoding, plan.crop, None, name, matrix, ())


def calibrate(plan: Plan, shots: Sequence[Taken]) -> Calibration:
    """Calibration of a RAW camera.

    Raises
    ------
    InputError
        A shot is missing, a frame cannot be read, or a value is not plausible.
    """
    dark, white, colours = (read_bracket(_only(shots, kind)) for kind in ("dark", "white", "chart"))
    monitors = [read_bracket(shot) for shot in shots if shot.kind == "monitor"]
    lit = [white, colours, *monitors]
    for bracket in (white, colours, *monitors):
        if bracket.planes.shape != dark.planes.shape or not np.array_equal(bracket.nominal_s, dark.nominal_s):
            raise InputError(
                f"shot '{bracket.shot.shot}': its size or its exposures are not those of the dark shot; shoot it again"
            )
    black, read, hot = measure_dark(dark)
    saturation = measure_saturation(white, black)
    gain = photon_transfer(white, site_black(white, black, dark.masked), saturation, read)
    response = Response(saturation, gain, read)
    exposures = measure_exposures(lit, [site_black(b, black, dark.masked) for b in lit], response)
    bad = hot | dead_sites(white, site_black(white, black, dark.masked), saturation)
    if bad.mean() > MOST_BAD:
        raise InputError(
            f"shot '{dark.shot.shot}': {bad.mean():.1%} of the sensor's sites are hot or dead; cover the lens"
            " and shoot it again"
        )
    sites = tuple((int(k), int(y), int(x)) for k, y, x in np.argwhere(bad))
    camera = Camera(black, dark.masked, response, exposures, sites, (1.0, 1.0, 1.0), None, None)
    rate, flags = merge_bracket(white, camera)
    rates = _plate(rate, flags, white.shot.shot)
    height, width = dark.planes.shape[2:]
    seen, seen_flags = merge_bracket(colours, camera)
    seen /= _falloff(plan, colours.shot.shot, height, width)
    matrix, errors = fit_colours(seen, seen_flags, np.array(rates), colours.shot.shot)
    camera = Camera(
        black,
        dark.masked,
        response,
        exposures,
        sites,
        rates,
        white.shot.photodiode,
        _monitor(monitors, white, camera),
    )
    return Calibration(
        plan.fabric,
        plan.sha256,
        height,
        width,
        "",
        "",
        camera,
        "camera RGB, white balanced",
        _rows(matrix),
        errors,
    )


def fit_colours(
    rate: NDArray[np.float32], flags: NDArray[np.uint8], white: Array, shot: str
) -> tuple[Array, tuple[float, ...]]:
    """Matrix from white-balanced camera RGB to ACEScg, and ΔE00 of each patch, left out in turn.

    Raises
    ------
    InputError
        Too few patches can be used, or their colours are not those of the chart.
    """
    usable = (flags & (SATURATED | HOT)).max(-1) == 0
    colours, seen = colour_chart.patches((rate / white).astype(np.float32), usable)
    if seen.sum() < 15:
        raise InputError(f"shot '{shot}': only {seen.sum()} of 24 patches can be used; shoot the chart again")
    reference = colour_chart.references()[seen]
    errors = colour_chart.leave_one_out(colours[seen], reference)
    if errors.mean() > MOST_DELTA_E:
        raise InputError(
            f"shot '{shot}': its patches are ΔE00 {errors.mean():.1f} from the chart's; put it upright,"
            " dark skin at the top left, so that it fills the picture"
        )
    return colour_chart.fit_matrix(colours[seen], reference), tuple(round(float(e), 4) for e in errors)


def _falloff(plan: Plan, name: str, height: int, width: int) -> NDArray[np.float32]:
    """Irradiance (y, x, 1) of a calibration shot relative to the middle; 1 where the lamp is not known."""
    shot = next(shot for group in plan.groups for shot in group.shots if shot.shot == name)
    if plan.lamp_mm is None or plan.field_mm is None:
        return np.ones((height, width, 1), np.float32)
    x, y, z = plan.lamp_mm * direction(math.radians(shot.theta), math.radians(shot.phi))
    return irradiance((x, y, z), height, width, plan.field_mm)[..., None]


def _only(shots: Sequence[Taken], kind: str) -> Taken:
    found = [shot for shot in shots if shot.kind == kind]
    if len(found) != 1:
        raise InputError(f"the manifests list {len(found)} shots of kind '{kind}'; capture the group `calibration`")
    return found[0]


def _plate(rate: NDArray[np.float32], flags: NDArray[np.uint8], shot: str) -> tuple[float, float, float]:
    """Mean counts a second over the middle half of the white plate."""
    height, width = rate.shape[:2]
    middle = np.s_[height // 4 : height - height // 4, width // 4 : width - width // 4]
    good = (flags[middle] & (SATURATED | HOT)) == 0
    if good.mean() < 0.5:
        raise InputError(f"shot '{shot}': the white plate is saturated at every exposure; add a shorter one")
    r, g, b = (float(rate[middle][..., k][good[..., k]].mean(dtype=float)) for k in range(3))
    if min(r, g, b) <= 0 or max(r, g, b) > 20 * min(r, g, b):
        raise InputError(f"shot '{shot}': the plate's R, G, B of {r:.3g}, {g:.3g}, {b:.3g} counts/s is not white")
    return r, g, b


def _monitor(monitors: Sequence[Bracket], white: Bracket, camera: Camera) -> float | None:
    """Level of the monitors under the lamp that lit the white plate."""
    levels = []
    for bracket in monitors:
        reading = bracket.shot.photodiode
        lamp = reading / white.shot.photodiode if reading and white.shot.photodiode else 1.0
        levels.append(level(*merge_bracket(bracket, camera)) / lamp)
    return float(np.median(levels)) if levels else None


def _rows(matrix: Array) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(a), float(b), float(c)) for a, b, c in matrix)


def _summary(calibration: Calibration) -> str:
    camera = calibration.camera
    if camera is None:
        return f"photographs of {calibration.width} × {calibration.height} texels, {calibration.encoding}"
    response, errors = camera.response, calibration.delta_e
    return (
        f"black {np.mean(camera.black):+.2f}, read noise {response.read:.2f},"
        f" saturation {response.saturation:.0f} counts, {1 / response.gain:.2f} electrons a count,"
        f" {len(camera.bad)} bad sites,"
        f" exposures {', '.join(f'1/{1 / e.seconds:.2f}' for e in camera.exposures)} s,"
        f" chart ΔE00 {np.mean(errors):.2f} (most {max(errors):.2f})"
    )
