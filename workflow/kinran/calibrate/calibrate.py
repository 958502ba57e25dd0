"""Calibrate the camera, the lamp and the colours of a capture.

The calibration is made from the shots of the group ``calibration`` (a covered lens, a white plate at θ = 0, a colour
chart at 45°) and from the repeats of θ = 0 in the given manifests. Every value is checked for plausibility, since an
error here affects all that follows. Photographs need no more than their encoding.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding, parse
from kinran.base.files import InputError
from kinran.base.frames import direction
from kinran.bracket.black_level import masked_border, site_black
from kinran.bracket.response_curve import Curve
from kinran.bracket.shots import FULL, Bracket, Taken, check_digest, read_bracket, read_manifest
from kinran.bracket.superpixels import merge_bracket
from kinran.bracket.uncalibrated import decoder_of, describe
from kinran.calibrate import colour_chart
from kinran.calibrate.chart_colours import fit_colours
from kinran.calibrate.chart_photograph import calibrate_colours
from kinran.calibrate.lamp import irradiance, level
from kinran.calibrate.radiometry import to_radiance
from kinran.calibrate.raw_camera import (
    MOST_BAD,
    dead_sites,
    measure_dark,
    measure_exposures,
    measure_saturation,
    photon_transfer,
)
from kinran.calibrate.white_card import measure_card
from kinran.calibrate.white_plate import fit_flat
from kinran.data.calibration import CalibratedCamera, Calibration, Response, write_calibration
from kinran.data.capture_plan import Plan, read_plan
from kinran.data.flat_field import Flat
from kinran.data.photographs import parse_crop
from kinran.data.photographs import read as read_photograph
from kinran.data.picture_kind import is_raw
from kinran.data.radiance import HOT, SATURATED, Image
from kinran.data.raw import camera_matrix

Array = NDArray[np.float64]

MOST_BRACKETS = 8
"""Brackets, spread over the set, on which their camera is measured: a choice."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    plan: Annotated[Path, "plan of the capture (.json)"]
    manifests: Annotated[
        tuple[Path, ...], "--manifests MANIFEST", "manifests of the calibration and of other groups (.json)"
    ]
    chart: Annotated[
        Path | None,
        "--chart FILE",
        "photograph of a colour chart, taken as the set is and under the same light; for photographs alone",
    ] = None
    flat: Annotated[
        Path | None,
        "--flat FOLDER",
        "photographs of a white card under the same lights, which even out the lamps; for photographs alone",
    ] = None


@dataclass(frozen=True)
class Options:
    chart_corners: Annotated[
        str,
        "--chart-corners X,Y,X,Y,X,Y,X,Y",
        "x,y of the chart's corners from the top left, dark skin's first, then around; without it, it is found",
    ] = ""
    lamp: Annotated[
        str, "whose spectrum lights the chart: xenon, D50, D65, A, …; without it, the chart's published colours"
    ] = ""


def main(
    inputs: Inputs, out: Annotated[Path, "OUT", "calibration to write (.json)"], options: Options = Options()
) -> None:
    """Write the calibration."""
    plan = read_plan(inputs.plan)
    shots = [shot for path in inputs.manifests for shot in read_manifest(path, plan)]
    if not plan.on_rig:
        alone = len(plan.exposures_s) == 1 and not (shots and shots[0].frames and is_raw(shots[0].frames[0].path))
        calibration = calibrate_photographs(plan, shots) if alone else calibrate_brackets(plan, shots)
        if inputs.flat:
            calibration = replace(calibration, lamps=measure_card(plan, calibration, inputs.flat))
        if inputs.chart:
            calibration = calibrate_colours(calibration, inputs.chart, options.chart_corners, options.lamp)
    else:
        calibration = calibrate(plan, shots, options.chart_corners, options.lamp)
    write_calibration(out, calibration)
    log.info(_summary(calibration))


def calibrate_photographs(plan: Plan, shots: Sequence[Taken]) -> Calibration:
    """Return the calibration of photographs: their size, and linear Rec. 709 for their colours.

    Raises
    ------
    InputError
        The first photograph cannot be read.
    """
    if not shots or not shots[0].frames:
        raise InputError(f"plan of {plan.fabric}: no photograph is listed; ingest the folder again")
    encoding = plan.encoding or ""
    first = read_photograph(check_digest(shots[0].frames[0]), parse(encoding), parse_crop(plan.crop))
    height, width = first.value.shape[:2]
    return Calibration(
        fabric=plan.fabric,
        plan_sha256=plan.sha256,
        height=height,
        width=width,
        encoding=encoding,
        crop=plan.crop,
        camera=None,
        colour="linear Rec. 709",
        to_acescg=_rows(colour_chart.REC709_TO_ACESCG),
        delta_e=(),
    )


def calibrate_brackets(plan: Plan, shots: Sequence[Taken]) -> Calibration:
    """Return the calibration of brackets without calibration shots, measured on up to eight of them.

    1 in the stack is white at the longest exposure. Photographs whose bracket contradicts their encoding get the
    encoding of the bracket; RAW frames get the colours that the camera's maker states for daylight.

    Raises
    ------
    InputError
        A frame cannot be read, or an exposure is mislabelled.
    """
    if not shots or not shots[0].frames:
        raise InputError(f"plan of {plan.fabric}: no photograph is listed; ingest the folder again")
    full = [shot for shot in shots if len(shot.frames) == len(plan.exposures_s)]
    if not full:
        raise InputError(f"plan of {plan.fabric}: no bracket has all {len(plan.exposures_s)} exposures; add the frames")
    some = [full[k] for k in np.linspace(0, len(full) - 1, min(MOST_BRACKETS, len(full))).round().astype(int)]
    first = some[len(some) // 2].frames
    raw = is_raw(first[0].path)
    crop, encoding = parse_crop(plan.crop), "linear" if raw else plan.encoding or "srgb"
    decoder: Encoding | Curve = parse(encoding)
    if not raw:
        paths, seconds = [frame.path for frame in first], [frame.nominal_s for frame in first]
        encoding, decoder = decoder_of(encoding, paths, seconds, crop, doubted=True)
    camera = describe([read_bracket(shot, decoder, crop) for shot in some])
    matrix, balance, name = np.eye(3), np.ones(3), "linear Rec. 709"
    if raw:
        balance, matrix = camera_matrix(first[0].path)
        name = "camera RGB, balanced for daylight"
    unit = (camera.response.saturation if raw else FULL) / camera.exposures[0].seconds
    r, g, b = (float(unit * part) for part in balance)
    height, width = read_bracket(replace(some[0], frames=some[0].frames[:1]), decoder, crop).planes.shape[2:]
    return Calibration(
        fabric=plan.fabric,
        plan_sha256=plan.sha256,
        height=height,
        width=width,
        encoding=encoding,
        crop=plan.crop,
        camera=replace(camera, white=(r, g, b)),
        colour=name,
        to_acescg=_rows(colour_chart.REC709_TO_ACESCG @ matrix),
        delta_e=(),
        curve=decoder.light if isinstance(decoder, Curve) else (),
    )


def calibrate(plan: Plan, shots: Sequence[Taken], corners: str = "", lamp: str = "") -> Calibration:
    """Return the calibration of a RAW camera.

    Parameters
    ----------
    plan, shots
        Plan and shots of the capture, among them a dark, a chart and at least one white shot.
    corners
        Corners of the chart, as `parse_corners` takes them; empty to detect it.
    lamp
        Name of the lamp on the chart, as `references` takes it; empty for the published colours.

    Raises
    ------
    InputError
        A shot is missing, a frame cannot be read, or a value is not plausible.
    """
    dark, colours = (read_bracket(_only(shots, kind)) for kind in ("dark", "chart"))
    whites = [read_bracket(shot) for shot in shots if shot.kind == "white"]
    whites.sort(key=lambda white: _pose(plan, white)[0])
    if not whites or _pose(plan, whites[0])[0] > 0:
        raise InputError("the manifests list no white plate at θ = 0; capture the group `calibration`")
    monitors = [read_bracket(shot) for shot in shots if shot.kind == "monitor"]
    lit = [*whites, colours, *monitors]
    for bracket in lit:
        if bracket.planes.shape != dark.planes.shape or not np.array_equal(bracket.nominal_s, dark.nominal_s):
            raise InputError(
                f"shot '{bracket.shot.shot}': its size or its exposures are not those of the dark shot; shoot it again"
            )
    camera = _measure_camera(dark, whites[0], lit)
    flats, white = zip(*(_plate(plan, bracket, camera) for bracket in whites), strict=True)
    camera = replace(camera, flats=flats, white=white[0], photodiode=whites[0].shot.photodiode)
    height, width = dark.planes.shape[2:]
    pose = _pose(plan, colours)
    seen = to_radiance(merge_bracket(colours, camera), camera, 1.0, *pose)
    seen = seen.with_value(seen.value / _falloff(plan, *pose, height, width))
    chart = fit_colours(seen, colours.shot.shot, corners, lamp)
    camera = replace(camera, glare=chart.glare)
    camera = replace(camera, monitor=_monitor(monitors, whites[0], camera))
    return Calibration(
        fabric=plan.fabric,
        plan_sha256=plan.sha256,
        height=height,
        width=width,
        encoding="",
        crop="",
        camera=camera,
        colour="camera RGB, white balanced",
        to_acescg=_rows(chart.matrix),
        delta_e=chart.delta_e,
        patches=chart.patches,
        root_polynomial=chart.root_polynomial,
        chart=chart.chart,
        lamp=lamp,
        generation=chart.generation,
    )


def _measure_camera(dark: Bracket, white: Bracket, lit: Sequence[Bracket]) -> CalibratedCamera:
    """Measure black level, saturation, noise, shutter times and bad sites."""
    masked = masked_border([dark, white, *lit])
    black, read, hot = measure_dark(dark, masked)
    levels = site_black(white, black, masked)
    saturation = measure_saturation(white, levels)
    gain, prnu = photon_transfer(white, levels, saturation, read)
    response = Response(saturation, gain, read)
    exposures = measure_exposures(lit, [site_black(b, black, masked) for b in lit], response)
    bad = hot | dead_sites(white, levels, saturation)
    if bad.mean() > MOST_BAD:
        raise InputError(
            f"shot '{dark.shot.shot}': {bad.mean():.1%} of the sensor's sites are hot or dead; cover the lens"
            " and shoot it again"
        )
    sites = tuple((int(k), int(y), int(x)) for k, y, x in np.argwhere(bad))
    return CalibratedCamera(black, masked, response, exposures, sites, prnu=prnu)


def _pose(plan: Plan, bracket: Bracket) -> tuple[float, float]:
    """Return (θ, φ) of a shot in degrees."""
    shot = next(shot for group in plan.groups for shot in group.shots if shot.shot == bracket.shot.shot)
    return shot.theta, shot.phi


def _falloff(plan: Plan, theta: float, phi: float, height: int, width: int) -> Image:
    """Return the irradiance (y, x, 1) relative to the middle; 1 where the lamp's distance is unknown."""
    if plan.lamp_mm is None or plan.field_mm is None:
        return np.ones((height, width, 1), np.float32)
    x, y, z = plan.lamp_mm * direction(math.radians(theta), math.radians(phi))
    return irradiance((x, y, z), height, width, plan.field_mm)[..., None]


def _only(shots: Sequence[Taken], kind: str) -> Taken:
    found = [shot for shot in shots if shot.kind == kind]
    if len(found) != 1:
        raise InputError(f"the manifests list {len(found)} shots of kind '{kind}'; capture the group `calibration`")
    return found[0]


def _plate(plan: Plan, bracket: Bracket, camera: CalibratedCamera) -> tuple[Flat, tuple[float, float, float]]:
    """Return the flat field of a white plate, and R, G, B in counts a second, corrected by it, over the middle half."""
    plate = merge_bracket(bracket, camera)
    height, width = plate.value.shape[:2]
    middle = np.s_[height // 4 : height - height // 4, width // 4 : width - width // 4]
    good = ~plate[middle].has(SATURATED | HOT)
    if good.mean() < 0.5:
        raise InputError(
            f"shot '{bracket.shot.shot}': the white plate is saturated at every exposure; add a shorter one"
        )
    pose = _pose(plan, bracket)
    falloff = _falloff(plan, *pose, height, width)
    flat = fit_flat(plate, falloff, *pose)
    even = plate.value / falloff / flat.values(height, width)
    r, g, b = (float(even[middle][..., k][good[..., k]].mean(dtype=float)) for k in range(3))
    if min(r, g, b) <= 0 or max(r, g, b) > 20 * min(r, g, b):
        raise InputError(
            f"shot '{bracket.shot.shot}': the plate's R, G, B of {r:.3g}, {g:.3g}, {b:.3g} counts/s is not white"
        )
    return flat, (r, g, b)


def _monitor(monitors: Sequence[Bracket], white: Bracket, camera: CalibratedCamera) -> float | None:
    """Return the median level of the monitors in counts a second under the lamp as it lit the white plate."""
    levels = []
    for bracket in monitors:
        reading = bracket.shot.photodiode
        lamp = reading / white.shot.photodiode if reading and white.shot.photodiode else 1.0
        levels.append(level(merge_bracket(bracket, camera)) / lamp)
    return float(np.median(levels)) if levels else None


def _rows(matrix: Array) -> tuple[tuple[float, float, float], ...]:
    return tuple((float(a), float(b), float(c)) for a, b, c in matrix)


def _summary(calibration: Calibration) -> str:
    camera = calibration.camera
    if camera is None:
        return f"photographs of {calibration.width} × {calibration.height} texels, {calibration.encoding}"
    if calibration.encoding:
        times = ", ".join(f"{e.seconds:.6g}" for e in camera.exposures)
        return f"brackets of {calibration.width} × {calibration.height} texels, {calibration.encoding}, of {times} s"
    response, errors = camera.response, calibration.delta_e
    flat = camera.flats[0].values(32, 32)
    return (
        f"black {np.mean(camera.black):+.2f}, read noise {response.read:.2f},"
        f" saturation {response.saturation:.0f} counts, {1 / response.gain:.2f} electrons a count,"
        f" {len(camera.bad)} bad sites,"
        f" exposures {', '.join(f'1/{1 / e.seconds:.2f}' for e in camera.exposures)} s,"
        f" flat field {flat.min():.3f} to {flat.max():.3f}, glare {camera.glare:.2%},"
        f" chart ΔE00 {np.mean(errors):.2f} (most {max(errors):.2f}) of {len(errors)} patches"
        + (f" (chart {calibration.generation})" if calibration.generation else "")
        + (", root polynomial" if calibration.root_polynomial else "")
    )
