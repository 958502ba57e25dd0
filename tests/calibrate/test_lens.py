"""Flat field, glare, curtains: faults of a camera that the calibration measures and the merge takes out."""

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from known_scene import EXPOSURES, radiance, shoot

from kinran.base.distances import Distances
from kinran.bracket.exposures import curtain
from kinran.bracket.shots import read_bracket, read_manifest
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate import calibrate
from kinran.calibrate.glare import estimate_glare, lift, veil
from kinran.calibrate.radiometry import to_radiance
from kinran.calibrate.white_plate import fit_flat
from kinran.capture.grid import plan_grid
from kinran.data.calibration import CalibratedCamera, Calibration, Response, read_calibration, write_calibration
from kinran.data.capture_plan import Plan, Shot, write_plan
from kinran.data.flat_field import Flat, divide, nearest
from kinran.data.radiance import HOT, SATURATED, Radiance
from kinran.radiance import merge_group
from kinran.virtual.sensor import CROSSTALK, Sensor

CAMERA = CROSSTALK / CROSSTALK.sum(1, keepdims=True)
TEXELS = 64


def calibrated(folder: Path, sensor: Sensor) -> tuple[Calibration, Plan, list[Path]]:
    plan = plan_grid("swatch", (0, 30, 50), 8, EXPOSURES, 4, Distances(lamp_mm=600.0, field_mm=4.8))
    write_plan(folder / "plan.json", plan)
    manifests = shoot(folder, plan, ("00", "calibration"), sensor, TEXELS)
    calibrate.main(calibrate.Inputs(folder / "plan.json", tuple(manifests)), folder / "c.json")
    return read_calibration(folder / "c.json"), plan, manifests


def ratio_to_truth(calibration: Calibration, plan: Plan, manifest: Path) -> tuple[np.ndarray, np.ndarray]:
    """Radiance of the first light over the truth, green; and the truth."""
    shots = read_manifest(manifest, plan)
    gains = merge_group.measure_gains(shots, calibration, manifest)
    shot = next(shot for shot in shots if shot.kind == "light")
    light = plan.lights[shot.light or 0]
    assert calibration.camera is not None
    picture = merge_bracket(read_bracket(shot), calibration.camera)
    seen = to_radiance(picture, calibration.camera, gains[shot.shot], light.theta, light.phi)[..., 1]
    true = (radiance(np.radians(light.theta), np.radians(light.phi), TEXELS) @ CAMERA.T)[..., 1]
    return np.where(seen.has(SATURATED | HOT), np.nan, seen.value / true), true


def test_vignetting_is_divided_out(tmp_path: Path) -> None:
    """A fifth of the light is missing in the corners: 0.5 % of it stays, by the plate; the curtain is found even."""
    calibration, plan, manifests = calibrated(tmp_path, Sensor(vignetting=0.2))
    camera = calibration.camera
    assert camera is not None
    assert all(exposure.curtain == () for exposure in camera.exposures)
    flat = camera.flats[0].values(TEXELS, TEXELS)[..., 1]
    y, x = np.meshgrid(np.linspace(-1, 1, TEXELS), np.linspace(-1, 1, TEXELS), indexing="ij")
    np.testing.assert_allclose(flat, 1 - 0.1 * (x**2 + y**2), atol=5e-3)
    ratio, true = ratio_to_truth(calibration, plan, manifests[0])
    lit = true > 0.05
    corners, middle = (np.hypot(x, y) > 1) & lit, (np.hypot(x, y) < 0.4) & lit
    assert np.nanmedian(ratio[corners]) == pytest.approx(np.nanmedian(ratio[middle]), abs=5e-3)
    ignored = replace(calibration, camera=replace(camera, flats=()))
    ratio, _ = ratio_to_truth(ignored, plan, manifests[0])
    assert np.nanmedian(ratio[corners]) < 0.9 * np.nanmedian(ratio[middle])


def test_glare_is_subtracted(tmp_path: Path) -> None:
    """2 % of the mean light over everything doubles dark silk; a tenth of that is left of it."""
    calibration, plan, manifests = calibrated(tmp_path, Sensor(glare=0.02))
    camera = calibration.camera
    assert camera is not None
    assert camera.glare == pytest.approx(0.02, abs=0.004)
    ratio, true = ratio_to_truth(calibration, plan, manifests[0])
    dark = (true > 2e-3) & (true < 2e-2)
    left = np.nanmedian(ratio[dark]) - 1
    ignored = replace(calibration, camera=replace(camera, glare=0.0))
    before = np.nanmedian(ratio_to_truth(ignored, plan, manifests[0])[0][dark]) - 1
    assert before > 0.5
    assert abs(left) < 0.3 * before


def test_curtains_are_calibrated(tmp_path: Path) -> None:
    """3 % at the edges of the fastest exposure, to 0.5 %."""
    calibration, _, _ = calibrated(tmp_path, Sensor(banding=0.03))
    assert calibration.camera is not None
    fastest = curtain(calibration.camera.exposures[-1].curtain, TEXELS)
    np.testing.assert_allclose(fastest, 1 + 0.03 * np.linspace(-1, 1, TEXELS), atol=5e-3)


def test_prnu_is_known(tmp_path: Path) -> None:
    calibration, _, _ = calibrated(tmp_path, Sensor(prnu=0.01))
    assert calibration.camera is not None
    assert calibration.camera.prnu == pytest.approx(0.01, rel=0.2)


def test_a_plate_for_each_direction(tmp_path: Path) -> None:
    """Each light takes the flat field of the plate whose direction is nearest; the white of θ = 0 stays the scale."""
    plan = plan_grid("swatch", (0, 30, 50), 8, EXPOSURES, 4, Distances(lamp_mm=600.0, field_mm=4.8))
    group = plan.groups[-1]
    oblique = Shot("white_30", "white", None, 30.0, 90.0)
    plan = replace(plan, groups=(*plan.groups[:-1], replace(group, shots=(*group.shots, oblique))))
    write_plan(tmp_path / "plan.json", plan)
    manifests = shoot(tmp_path, plan, ("calibration",), Sensor(), 32)
    found = calibrate.calibrate(plan, read_manifest(manifests[0], plan))
    assert found.camera is not None
    assert [(flat.theta, flat.phi) for flat in found.camera.flats] == [(0, 0), (30, 90)]
    for flat in found.camera.flats:
        np.testing.assert_allclose(flat.values(32, 32), 1, atol=0.01)
    write_calibration(tmp_path / "c.json", found)
    assert read_calibration(tmp_path / "c.json") == found


def test_the_nearest_flat() -> None:
    flats = tuple(Flat(theta, phi, ()) for theta, phi in ((0, 0), (60, 0), (60, 350), (80, 180)))
    for pose, k in (((5, 77), 0), ((50, 3), 1), ((70, 345), 2), ((89, 170), 3)):
        assert nearest(flats, *pose) is flats[k]
    assert nearest((), 0, 0) is None


def test_a_flat_that_is_no_number() -> None:
    """NaN, infinity, 0 and less make no infinity, but flagged samples."""
    flat = np.ones((2, 3, 3), np.float32)
    flat[0, :, 0] = np.nan, 0, -1
    flat[1, 0] = np.inf
    divided = divide(Radiance.unflagged(np.ones((2, 3, 3), np.float32)), flat)
    assert np.isfinite(divided.value).all()
    assert divided.has(HOT).sum() == 6
    np.testing.assert_array_equal(divided.value[divided.has(HOT)], 0)


def test_dust_on_the_plate_is_not_in_the_flat() -> None:
    rng = np.random.default_rng(0)
    rate = (1000 * (1 + 0.005 * rng.standard_normal((64, 64, 3)))).astype(np.float32)
    rate[10:13, 40:44] *= 0.5
    rate[5, 5] = np.nan
    flat = fit_flat(Radiance.unflagged(rate), np.ones((64, 64, 1), np.float32), 0, 0)
    np.testing.assert_allclose(flat.values(64, 64), 1, atol=3e-3)


def test_no_glare_where_patches_only_scatter() -> None:
    """Patches that are 3 % off, each in its way, are no veil."""
    rng = np.random.default_rng(1)
    greys = np.array([0.88, 0.59, 0.36, 0.19, 0.09, 0.031])
    found = [estimate_glare(greys * (1 + 0.03 * rng.standard_normal(6)), greys, 0.25) for _ in range(50)]
    assert np.count_nonzero(found) <= 3


def test_glare_and_its_removal_are_each_others_inverse() -> None:
    rng = np.random.default_rng(2)
    light = (10 ** rng.uniform(-3, 1, (40, 40, 3))).astype(np.float32)
    seen = Radiance.unflagged(light + np.float32(0.03) * light.mean((0, 1)))
    np.testing.assert_allclose(lift(seen, veil(seen, 0.03)).value, light, rtol=1e-3, atol=1e-5)


def test_a_full_picture_takes_little_memory() -> None:
    """What is temporary is a strip: flat field and glare of a picture cost under half of it beyond what comes out."""
    picture = Radiance.unflagged(np.ones((2400, 200, 3), np.float32))
    flat = Flat(0.0, 0.0, ((1.0, *[0.0] * 13, -0.05),) * 3)
    response = Response(3470, 0.08, 1.7)
    camera = CalibratedCamera((256.0,) * 4, False, response, (), (), glare=0.01, flats=(flat,))
    to_radiance(picture, camera, 1.0, 0, 0)
    tracemalloc.start()
    found = to_radiance(picture, camera, 1.0, 0, 0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak - found.value.nbytes - found.flags.nbytes < 0.5 * picture.value.nbytes
    assert not found.flags.any()


def test_a_flat_field_in_rows_is_the_whole_one() -> None:
    """At the same places the smooth surface is the same, in strips and at once, as the sum of its products says."""
    coefficients = np.random.default_rng(0).normal(0, 0.1, (3, 15)) + np.eye(1, 15)
    flat = Flat(0.0, 0.0, tuple(tuple(float(v) for v in row) for row in coefficients))
    whole = flat.values(40, 30)
    strips = [flat.values(40, 30, slice(first, first + 16)) for first in (0, 16, 32)]
    np.testing.assert_array_equal(np.concatenate(strips), whole)
    y, x = (np.arange(n) * 2 / n - 1 + 1 / n for n in (40, 30))
    grid = np.zeros((5, 5))
    grid[[0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 3, 3, 4], [0, 1, 2, 3, 4, 0, 1, 2, 3, 0, 1, 2, 0, 1, 0]] = coefficients[1]
    np.testing.assert_allclose(whole[..., 1], np.polynomial.legendre.leggrid2d(y, x, grid), atol=1e-6)
