"""A colour chart beside a set of photographs: what its colours mend, from a JPEG, a TIFF and a RAW file."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from raw_frames import TRUE, bracket, expose, write
from test_colour_chart import CAMERA, chart

from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.bracket.shots import Taken, read_bracket
from kinran.bracket.uncalibrated import describe
from kinran.calibrate import colour_chart
from kinran.calibrate.chart_photograph import calibrate_colours
from kinran.data.calibration import CalibratedCamera, Calibration

CAST = np.array([1.25, 1.0, 0.6])
"""A camera that was balanced for another light."""
BELIEVED = tuple(tuple(float(v) for v in row) for row in colour_chart.REC709_TO_ACESCG)


def photographs(encoding: str, camera: CalibratedCamera | None = None) -> Calibration:
    return Calibration("icon", "", 8, 8, encoding, "", camera, "linear Rec. 709", BELIEVED, ())  # type: ignore[arg-type]


def error(calibration: Calibration) -> float:
    """Mean ΔE00 of colours that are not the chart's: mixtures of two patches each, as this camera sees them."""
    reference = colour_chart.references()
    truth = 0.5 * (reference + np.roll(reference, 5, axis=0))
    seen = truth @ CAMERA.T * CAST
    found = colour_chart.apply(calibration.matrix, seen)
    return float(colour_chart.delta_e(found * (truth.sum() / found.sum()), truth).mean())


def save(path: Path, light: np.ndarray) -> Path:
    """Photograph of (y, x, 3), row 0 at the bottom."""
    upright = np.clip(light[::-1], 0, 1)
    if path.suffix == ".tif":
        tifffile.imwrite(path, np.round(upright * 65535).astype(np.uint16), photometric="rgb")
    else:
        Image.fromarray(np.round(parse("srgb").encode(upright) * 255).astype(np.uint8)).save(path, quality=95)
    return path


@pytest.mark.parametrize(("name", "encoding"), [("chart.jpg", "srgb"), ("chart.tif", "linear")])
def test_a_cast_and_a_cameras_colours_are_mended(tmp_path: Path, name: str, encoding: str) -> None:
    """ΔE00 of colours that the chart does not have: over 10 as the encoding states them, under 1.5 by the chart."""
    path = save(tmp_path / name, chart() * CAST * 0.55)
    before = photographs(encoding)
    after = calibrate_colours(before, path, "", "")
    assert error(before) > 10
    assert error(after) < 1.5
    assert after.colour == "camera RGB, by a colour chart"
    assert len(after.chart) == 24
    assert np.mean(after.delta_e) < 1.5  # black is noise in 8 bits
    np.testing.assert_allclose(after.matrix @ CAST, (after.matrix @ CAST)[1], rtol=0.01)  # white is white


def test_a_large_picture_and_its_corners(tmp_path: Path) -> None:
    """Corners are in the photograph's pixels, also where it is taken at a third."""
    light = np.full((2000, 3000, 3), 0.3, np.float32)
    light[400:1600, 900:2700] = np.kron(chart(), np.ones((10, 10, 1)))
    path = save(tmp_path / "chart.tif", light * CAST * 0.55)
    found = calibrate_colours(photographs("linear"), path, "900,400,2700,400,2700,1600,900,1600", "")
    assert error(found) < 1.5
    with pytest.raises(InputError, match="corners 'a,b'"):
        calibrate_colours(photographs("linear"), path, "a,b", "")


def test_saturated_patches_are_left_out(tmp_path: Path) -> None:
    found = calibrate_colours(photographs("linear"), save(tmp_path / "chart.tif", chart() * CAST * 1.05), "", "")
    assert found.chart[18].left_out == "saturated"
    assert error(found) < 1.5


def test_raw(tmp_path: Path) -> None:
    """A RAW chart beside RAW brackets: in the stack's RGB, which is balanced for daylight."""
    level = chart()[::-1] * CAST * 2e6
    sites = np.empty((2 * level.shape[0], 2 * level.shape[1]))
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        sites[row::2, column::2] = level[..., channel]
    path = write(tmp_path / "chart.dng", expose(sites, TRUE[100], np.random.default_rng(0)), 100)
    frames = bracket(tmp_path / "light", sites)
    shot = Taken("light", "light", 0, None, None, tuple(_frame(frame) for frame in frames))
    balance = np.array([2.0, 1.0, 0.7])
    camera = describe([read_bracket(shot)])
    r, g, b = (float(v) for v in 1000.0 * balance)
    calibration = photographs("linear", CalibratedCamera(**{**vars(camera), "white": (r, g, b)}))
    found = calibrate_colours(calibration, path, "", "")
    balanced = Calibration(**{**vars(found), "to_acescg": tuple(map(tuple, found.matrix / balance))})
    assert error(balanced) < 1.5


def _frame(path: Path) -> object:
    from kinran.bracket.shots import Frame

    return Frame(path, 1 / int(path.stem.split("_")[1]))


def test_what_must_stop(tmp_path: Path) -> None:
    """No chart, and one whose picture has a tone curve."""
    noise = 0.8 * np.random.default_rng(0).random((60, 90, 3))
    with pytest.raises(InputError, match=r"shot 'none.tif': .*develop it without a tone curve"):
        calibrate_colours(photographs("linear"), save(tmp_path / "none.tif", noise), "", "")
    with pytest.raises(InputError, match=r"missing\.jpg: no such file"):
        calibrate_colours(photographs("srgb"), tmp_path / "missing.jpg", "", "")
