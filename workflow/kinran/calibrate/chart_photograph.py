"""Colours of a set of photographs, from a photograph of a colour chart with the same settings and light."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding, parse
from kinran.bracket.response_curve import Curve
from kinran.calibrate.chart_colours import fit_colours
from kinran.data.block_average import average
from kinran.data.calibration import Calibration
from kinran.data.photographs import read as read_photograph
from kinran.data.picture_kind import is_raw
from kinran.data.radiance import SATURATED, Radiance
from kinran.data.raw import RawFrame, read_raw

LARGEST = 1200
"""Most pixels along the longer side of the picture of a chart: the detector's time grows with them."""


def calibrate_colours(calibration: Calibration, path: Path, corners: str, lamp: str) -> Calibration:
    """Return the calibration of photographs with the colours of a chart, whose grey patches define white.

    Parameters
    ----------
    calibration
        Calibration of the photographs.
    path
        Photograph of the chart.
    corners
        Corners as `parse_corners` takes them, in pixels of the photograph (of RAW: superpixels); empty to detect it.
    lamp
        Name of the lamp on the chart, as `references` takes it; empty for the published colours.

    Raises
    ------
    InputError
        The photograph cannot be read, or `fit_colours` finds no chart in it.
    """
    picture = _read(path, calibration)
    step = math.ceil(max(picture.value.shape[:2]) / LARGEST)
    chart = fit_colours(_smaller(picture, step), path.name, _over(corners, step), lamp, greys=True)
    return replace(
        calibration,
        colour="camera RGB, by a colour chart",
        to_acescg=tuple((float(r), float(g), float(b)) for r, g, b in chart.matrix),
        delta_e=chart.delta_e,
        patches=chart.patches,
        root_polynomial=chart.root_polynomial,
        chart=chart.chart,
        lamp=lamp,
        generation=chart.generation,
    )


def _read(path: Path, calibration: Calibration) -> Radiance:
    """Read light (y, x, 3) in the stack's RGB, on any scale; row 0 is the bottom."""
    if is_raw(path):
        raw = read_raw(path).upright()
        sites = raw.planes.astype(np.float32) - _black(raw, calibration)[:, None, None].astype(np.float32)
        light = np.stack([sites[0], (sites[1] + sites[2]) / 2, sites[3]], -1)
        full = calibration.camera.response.clip if calibration.camera else raw.white - float(raw.black.mean())
        over = np.stack([sites[0], np.maximum(sites[1], sites[2]), sites[3]], -1) > full
        picture = Radiance(light, over * np.uint8(SATURATED))
    else:
        decoder: Encoding | Curve = Curve(calibration.curve) if calibration.curve else parse(calibration.encoding)
        picture = read_photograph(path, parse("linear"))
        picture = picture.with_value(np.asarray(decoder.decode(picture.value), np.float32))
    white = np.array(calibration.camera.white, np.float32) if calibration.camera else np.ones(3, np.float32)
    return picture.with_value(picture.value / (white / white[1]))


def _black(raw: RawFrame, calibration: Calibration) -> NDArray[np.float64]:
    """Return the black levels (4,) of a chart's RAW file: those of the set's camera, if that has been measured."""
    camera = calibration.camera
    if camera is None or len(camera.black) != len(raw.black) or (camera.masked and raw.mask is None):
        return raw.black
    return np.array(camera.black) + (raw.mask if camera.masked and raw.mask is not None else 0.0)


def _smaller(picture: Radiance, step: int) -> Radiance:
    """Return the means of blocks from the top left."""
    height, width = (side // step * step for side in picture.value.shape[:2])
    return average(picture[len(picture.value) - height :, :width][None], step)[0]


def _over(corners: str, step: int) -> str:
    """Return corners in units of blocks; unchanged where they are not numbers, which `parse_corners` refuses."""
    try:
        return ",".join(f"{float(word) / step:.6f}" for word in corners.split(",")) if corners else ""
    except ValueError:
        return corners
