"""Calibrate, merge and stack against a scene of known radiance, from DNG files to the stack."""

import errno
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from known_scene import SCENE, Capture, radiance

from kinran.__main__ import main
from kinran.base.files import InputError, sha256, write_json
from kinran.bracket.noise import sigma
from kinran.bracket.shots import read_bracket, read_manifest
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate import calibrate, colour_chart
from kinran.capture.grid import plan_grid
from kinran.data.calibration import Calibration, read_calibration, write_calibration
from kinran.data.capture_plan import write_plan
from kinran.data.hold_out_rule import held_out
from kinran.data.radiance import DARK, HOT, SATURATED, SHIFTED, Radiance
from kinran.data.radiance_stack import Stack
from kinran.data.raw import read_raw
from kinran.data.shards import shard_path
from kinran.radiance import merge_group
from kinran.radiance import stack as stack_stage
from kinran.virtual.sensor import CROSSTALK, Sensor, _defects, shutter

TEXELS = int(SCENE["texels"])
CAMERA = CROSSTALK / CROSSTALK.sum(1, keepdims=True)
"""Scene RGB to white-balanced camera RGB."""


def run_calibrate(capture: Capture, out: Path) -> Calibration:
    calibrate.main(calibrate.Inputs(capture.plan_path, tuple(capture.manifests)), out)
    return read_calibration(out)


@pytest.fixture(scope="module")
def calibration(capture: Capture) -> Calibration:
    return run_calibrate(capture, capture.folder / "calibration.json")


@pytest.fixture(scope="module")
def stack(capture: Capture, calibration: Calibration) -> Stack:
    for group in ("00", "01"):
        run_merge(capture, group)
    run_stack(capture, 4)
    return Stack.open(capture.folder / "radiance.zarr")


def run_merge(capture: Capture, group: str, out: str = "radiance.zarr", manifest: Path | None = None) -> None:
    calibration, manifest = capture.folder / "calibration.json", manifest or capture.manifest(group)
    outputs = merge_group.Outputs(capture.folder / out, capture.folder / f"{group}.json")
    merge_group.main(merge_group.Inputs(capture.plan_path, calibration, manifest), outputs)


def run_stack(capture: Capture, holdout: int) -> None:
    inputs = stack_stage.Inputs(
        capture.plan_path,
        capture.folder / "calibration.json",
        tuple(capture.manifests),
        (capture.folder / "00.json", capture.folder / "01.json"),
    )
    stack_stage.main(inputs, capture.folder / "radiance.zarr", stack_stage.Options(holdout))


def truth(capture: Capture) -> np.ndarray:
    """π·T of all lights in the stack's RGB."""
    pictures = [radiance(np.radians(light.theta), np.radians(light.phi), TEXELS) for light in capture.plan.lights]
    return np.stack(pictures) @ CAMERA.T


def test_the_camera_is_measured(calibration: Calibration) -> None:
    """Read noise to 5 %, gain to 10 %, saturation to 0.2 %, black to 0.1 counts, ratios to 0.25 %.

    The ratios are those of five brackets under a lamp that flickers by 0.1 % from frame to frame.
    """
    camera, sensor = calibration.camera, Sensor()
    assert camera is not None
    assert camera.response.read == pytest.approx(np.hypot(sensor.read / sensor.gain, 12**-0.5), rel=0.05)
    assert 1 / camera.response.gain == pytest.approx(sensor.gain, rel=0.1)
    assert camera.response.saturation == pytest.approx(sensor.clip - sensor.black, rel=2e-3)
    assert camera.masked
    np.testing.assert_allclose(camera.black, 0, atol=0.1)
    for exposure in camera.exposures[1:]:
        true = shutter(exposure.nominal_s) / shutter(camera.exposures[0].nominal_s)
        assert exposure.seconds / camera.exposures[0].seconds == pytest.approx(true, rel=2.5e-3)
        assert exposure.sites > 1000


def test_as_the_rule_calls_it(capture: Capture, calibration: Calibration, tmp_path: Path) -> None:
    """OUT comes first, so that it is not taken for a manifest."""
    manifests = [str(path) for path in capture.manifests]
    command = ["calibrate", str(tmp_path / "c.json"), "--plan", str(capture.plan_path), "--manifests", *manifests]
    assert main(command) == 0
    assert read_calibration(tmp_path / "c.json") == calibration


def test_hot_sites_are_found(capture: Capture, calibration: Calibration) -> None:
    """All sites whose dark current shows in the longest exposure by 10 σ, and no more than 0.1 % others."""
    sensor = Sensor()
    _, dark = _defects(sensor, (2 * TEXELS + 8, 2 * TEXELS), int(SCENE["seed"]))
    shown = dark[8:] / 25.4 > 10 * sensor.read
    found = np.zeros((2 * TEXELS, 2 * TEXELS), bool)
    for plane, y, x in calibration.camera.bad:  # type: ignore[union-attr]
        row, column = ((0, 0), (0, 1), (1, 0), (1, 1))[plane]
        found[2 * (TEXELS - 1 - y) + row, 2 * x + column] = True
    assert found[shown].all()
    assert found.sum() - shown.sum() <= 4


def test_colours_come_out_as_acescg(calibration: Calibration) -> None:
    """The matrix is that of the sensor's crosstalk to 0.01, white stays white, ΔE00 is under 0.5."""
    expected = colour_chart.REC709_TO_ACESCG @ np.linalg.inv(CAMERA)
    np.testing.assert_allclose(calibration.matrix, expected, atol=0.01)
    np.testing.assert_allclose(calibration.matrix.sum(1), 1, atol=1e-12)
    assert np.mean(calibration.delta_e) < 0.5


def test_the_stack_is_the_scene(capture: Capture, stack: Stack) -> None:
    """One scale to 0.4 %, all decades on it to 0.15 %, and the noise is that of the sensor.

    The scale is that of one white plate, under a lamp that flickers by 0.1 % from frame to frame.
    """
    seen = stack.read_tile(0, TEXELS, 0, TEXELS)
    values, flags = seen.value, seen.flags
    expected = truth(capture)
    good = (flags & (SATURATED | HOT)) == 0
    scale = np.median(values[good & (expected > 0.1)] / expected[good & (expected > 0.1)])
    assert scale == pytest.approx(1, abs=4e-3)
    for low, high, noise in ((1e-3, 1e-2, 0.08), (1e-2, 0.1, 0.015), (0.1, 1, 0.01), (1, 15, 0.01)):
        use = good & (expected > low) & (expected < high)
        assert use.sum() > 1000
        bias = values[use].sum() / expected[use].sum() / scale - 1
        assert abs(bias) < 1.5e-3, (low, bias)
        assert np.sqrt(np.mean((values[use] / expected[use] - 1) ** 2)) < noise, low


def test_the_noise_model_of_the_stack_is_that_of_its_samples(capture: Capture, stack: Stack) -> None:
    """z-rms of (value − truth) / σ within 10 % of 1 in each decade, with 0.2 % for the lamp and half floats."""
    seen = stack.read_tile(0, TEXELS, 0, TEXELS)
    values, flags = seen.value, seen.flags
    expected = truth(capture)
    spread = np.hypot(sigma(expected.astype(np.float32), stack.noise), 2e-3 * expected)
    for low, high in ((1e-3, 1e-2), (1e-2, 0.1), (0.1, 1), (1, 15)):
        use = ((flags & (SATURATED | HOT)) == 0) & (expected > low) & (expected < high)
        z = (values - expected)[use] / spread[use]
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.1), low


def test_saturated_samples_are_flagged_lower_bounds(capture: Capture, stack: Stack) -> None:
    seen = stack.read_tile(0, TEXELS, 0, TEXELS)
    values, flags = seen.value, seen.flags
    full, expected = (flags & SATURATED) > 0, truth(capture)
    corner = np.s_[:-1, TEXELS - 2 :, :2, 1]  # 30 times white, but not at θ = 0
    assert full[corner].all()
    assert (values[full] < expected[full]).all()
    assert values[full].min() > 0.5 * 18
    assert not (flags[full] & DARK).any()
    assert full.mean() < 0.02


def test_darkness_is_flagged(capture: Capture, stack: Stack) -> None:
    seen = stack.read_tile(0, TEXELS, 0, TEXELS)
    values, flags = seen.value, seen.flags
    dark = (flags & DARK) > 0
    assert dark.any()
    assert truth(capture)[dark].max() < 5e-3
    assert (dark & (values > 0)).any()


def test_the_lamp_is_taken_out(capture: Capture, stack: Stack) -> None:
    """A lamp that drifts by 3 % over a group leaves 0.2 % from light to light."""
    seen = stack.read_tile(0, TEXELS, 0, TEXELS)
    values, flags = seen.value, seen.flags
    ratio = np.where((flags == 0) & (truth(capture) > 0.05), values / truth(capture), np.nan)
    by_light = np.nanmedian(ratio, axis=(1, 2, 3))
    np.testing.assert_allclose(by_light / np.median(by_light), 1, atol=2e-3)
    lamp = json.loads((capture.folder / "00.json").read_text())["lamp"].values()
    assert max(lamp) - min(lamp) > 0.025


def test_a_lamp_that_jumps_within_a_bracket_bends_nothing(capture: Capture, calibration: Calibration) -> None:
    """One frame is 2 % brighter: all levels move by the same 0.4 %, where fixed times bend them by 1 %."""
    shots = {shot.shot: shot for shot in read_manifest(capture.manifest("00"), capture.plan)}
    bracket = read_bracket(shots["t20_p000"])
    planes = bracket.planes.copy()
    black = bracket.black[1][:, None, None]
    brighter = (planes[1] - black) * 1.02 + black
    planes[1] = np.where(planes[1] < planes.max(), np.minimum(brighter.round(), planes.max()), planes[1])
    jumped = replace(bracket, planes=planes)
    camera = calibration.camera
    assert camera is not None

    def steps() -> np.ndarray:
        first = merge_bracket(bracket, camera)
        before, after = first.value, merge_bracket(jumped, camera).value
        use, value = (first.flags == 0), before / np.array(camera.white)
        levels = ((3e-3, 2e-2), (0.06, 0.2), (0.5, 20))
        masks = [use & (value > low) & (value < high) for low, high in levels]
        return np.array([after[m].sum() / before[m].sum() - 1 for m in masks])

    moved = steps()
    assert np.ptp(moved) < 2e-3
    np.testing.assert_allclose(moved, 0.004, atol=2e-3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("kinran.bracket.superpixels.FLICKER", 1e-9)
        assert np.ptp(steps()) > 8e-3


def test_without_a_photodiode_the_monitors_tell(capture: Capture, calibration: Calibration) -> None:
    """Interpolated over time: of a drift of 3 % in two minutes, 1 % is left at most."""
    shots = [replace(shot, photodiode=None) for shot in read_manifest(capture.manifest("00"), capture.plan)]
    with_diode = json.loads((capture.folder / "00.json").read_text())["lamp"]
    gains = merge_group.measure_gains(shots, calibration, capture.manifest("00"))
    assert gains.keys() == with_diode.keys()
    for shot, gain in gains.items():
        assert gain == pytest.approx(with_diode[shot], abs=0.01)


def test_each_light_has_its_shot(capture: Capture, stack: Stack) -> None:
    assert [light.name for light in stack.lights] == [light.name for light in capture.plan.lights]
    assert stack.lights[3].grid == capture.plan.lights[3].grid
    assert stack.lights[3].position_mm == capture.plan.lights[3].position_mm
    assert stack.texel_mm == pytest.approx(4.8 / TEXELS)
    values = stack.read_tile(0, TEXELS, 0, TEXELS).value
    for i, picture in enumerate(truth(capture)):
        error = [np.abs(value - picture).mean() for value in values]
        assert np.argmin(error) == i


def test_another_holdout_redoes_no_merge(capture: Capture, stack: Stack) -> None:
    before = shard_path(stack.path, "radiance", 0).stat().st_mtime_ns
    run_stack(capture, 3)
    again = Stack.open(stack.path)
    assert shard_path(stack.path, "radiance", 0).stat().st_mtime_ns == before
    held = [light.grid for light in again.lights if light.held_out]
    assert held
    assert all((t + p) % 3 == 1 and t > 0 for t, p in held if t is not None)  # type: ignore[misc]
    run_stack(capture, 0)
    assert not Stack.open(stack.path).held_out.any()


def test_merging_twice_gives_the_same_bytes(capture: Capture, stack: Stack) -> None:
    run_merge(capture, "00", "again.zarr")
    for name in ("radiance", "flags"):
        one, two = (shard_path(capture.folder / z, name, 0).read_bytes() for z in ("radiance.zarr", "again.zarr"))
        assert one == two


@pytest.fixture
def shared(capture: Capture, calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of a fabric of another name and with another chart, of which someone merged the frames; it has none."""
    folder = tmp_path / "other"
    (folder / "groups").mkdir(parents=True)
    monkeypatch.setenv("KINRAN_CACHE", str(tmp_path))
    run_merge(capture, "00", "shared.zarr")
    plan = replace(capture.plan, fabric="other")
    write_plan(folder / "plan.json", plan)
    manifest = json.loads(capture.manifest("00").read_text()) | {"plan_sha256": plan.sha256}
    write_json(folder / "groups" / "00.json", manifest)
    named = replace(calibration, fabric="other", plan_sha256=plan.sha256, lamp="A", delta_e=())
    write_calibration(folder / "calibration.json", named)
    return folder


def other(folder: Path, capture: Capture) -> Capture:
    return Capture(folder, replace(capture.plan, fabric="other"), folder / "plan.json", [folder / "groups" / "00.json"])


def test_a_merge_is_shared(capture: Capture, shared: Path) -> None:
    """Shards and receipt are those of a merge of one's own, where there is no frame to merge."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("KINRAN_CACHE")
        run_merge(capture, "00", "own.zarr")
    own = json.loads((capture.folder / "00.json").read_text())
    run_merge(other(shared, capture), "00")
    taken = json.loads((shared / "00.json").read_text())
    assert list(taken.items()) == list((own | {"fabric": "other"}).items())
    for name in own["sha256"]:
        assert (shared / "radiance.zarr" / name).read_bytes() == (capture.folder / "own.zarr" / name).read_bytes()


def flip(shot: dict[str, list[dict[str, str]]]) -> None:
    digest = shot["frames"][1]["sha256"]
    shot["frames"][1]["sha256"] = ("1" if digest[0] == "0" else "0") + digest[1:]


@pytest.mark.parametrize(
    "change",
    [
        flip,
        lambda shot: shot["frames"][1].update(exposure_s=0.011),
        lambda shot: shot["frames"][1].update(file="frames/x.png"),
        lambda shot: shot.update(photodiode=1e5),
        lambda shot: shot.update(time_s=1.0),
        None,
    ],
)
def test_another_merge_is_not_taken(capture: Capture, shared: Path, change: Callable[[Any], None] | None) -> None:
    """Of another frame, exposure or lamp, or with another calibration: it is merged, for which it has no frames."""
    if change:
        edit(shared / "groups" / "00.json", "t40_p000", change)
    else:
        found = read_calibration(shared / "calibration.json")
        assert found.camera
        write_calibration(
            shared / "calibration.json", replace(found, camera=replace(found.camera, glare=found.camera.glare + 1e-9))
        )
    with pytest.raises(InputError, match=r"no such file|no file of the kind"):
        run_merge(other(shared, capture), "00")


def test_repeats_of_a_light_are_averaged_one_by_one() -> None:
    """A saturated sample counts only where all are; dark where all are, shifted where one is. No picture is kept."""
    values = np.array([[1.0, 5.0, 9.0], [3.0, 2.0, 7.0], [2.0, 2.0, 8.0]], np.float32)
    flags = np.array([[DARK, SATURATED, SATURATED], [DARK, SHIFTED, SATURATED], [DARK, 0, SATURATED]], np.uint8)
    repeats = stack_stage.Repeats((1, 1, 3))
    for value, bits in zip(values, flags, strict=True):
        repeats.add(Radiance(value.reshape(1, 1, 3), bits.reshape(1, 1, 3)))
        value[:] = np.nan
    mean = repeats.mean()
    np.testing.assert_allclose(mean.value[0, 0], [2, 2, 8])
    np.testing.assert_array_equal(mean.flags[0, 0], [DARK, SHIFTED, SATURATED])


# -- what must stop --------------------------------------------------------------------------------------


@pytest.fixture
def broken(capture: Capture, calibration: Calibration, tmp_path: Path) -> Capture:
    """A copy of the capture, to break."""
    folder = tmp_path / "swatch"
    shutil.copytree(capture.folder, folder, ignore=shutil.ignore_patterns("*.zarr", "card", "cache"))
    manifests = [folder / "groups" / path.name for path in capture.manifests]
    return Capture(folder, capture.plan, folder / "plan.json", manifests)


def edit(manifest: Path, shot: str, change: object) -> None:
    value = json.loads(manifest.read_text())
    change(next(s for s in value["shots"] if s["shot"] == shot))  # type: ignore[operator]
    manifest.write_text(json.dumps(value))


def swap_files(entry: dict[str, list[dict[str, str]]]) -> None:
    a, b = entry["frames"][2], entry["frames"][4]
    for key in ("file", "sha256"):
        a[key], b[key] = b[key], a[key]


def test_a_truncated_frame(broken: Capture) -> None:
    frame = broken.folder / "frames" / "t40_p000_250.dng"
    frame.write_bytes(frame.read_bytes()[:4000])
    edit(broken.manifest("00"), "t40_p000", lambda entry: [each.pop("sha256") for each in entry["frames"]])
    with pytest.raises(InputError, match=r"t40_p000_250\.dng: cannot be read as RAW"):
        run_merge(broken, "00")
    assert not list((broken.folder / "radiance.zarr").iterdir())  # no half shard, and no scratch


def test_frames_of_unknown_content_are_not_shared(
    broken: Capture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shared = tmp_path / "shared"
    shared.mkdir()
    monkeypatch.setenv("KINRAN_CACHE", str(shared))
    run_merge(broken, "00")
    assert len(list(shared.iterdir())) == 1
    edit(broken.manifest("00"), "t40_p000", lambda entry: [each.pop("sha256") for each in entry["frames"]])
    run_merge(broken, "00")
    assert len(list(shared.iterdir())) == 1


@pytest.mark.parametrize("name", ["t40_p000_250", "white_1000", "dark_25"])
def test_a_flipped_bit_of_a_frame(broken: Capture, name: str) -> None:
    """It decodes, as another picture: only its digest tells."""
    frame = broken.folder / "frames" / f"{name}.dng"
    data = bytearray(frame.read_bytes())
    data[len(data) * 3 // 4] ^= 8
    frame.write_bytes(data)
    read_raw(frame)
    said = f"{name}.dng: has other bytes than when it was taken .*; run `kinran rig repair {broken.plan.fabric}`"
    run = partial(run_merge, broken, "00") if name == "t40_p000_250" else partial(run_calibrate, broken, Path("c.json"))
    with pytest.raises(InputError, match=said):
        run()


def test_a_frame_that_cannot_be_read(broken: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(path: Path) -> str:
        raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))

    monkeypatch.setattr("kinran.bracket.shots.sha256", failing)
    with pytest.raises(InputError, match=r"\.dng: cannot be read .Input/output error.; run `kinran rig repair"):
        run_merge(broken, "00")


def test_a_missing_frame(broken: Capture) -> None:
    (broken.folder / "frames" / "t40_p000_250.dng").unlink()
    with pytest.raises(InputError, match=r"t40_p000_250\.dng: no such file"):
        run_merge(broken, "00")


def test_a_swapped_exposure_is_seen_in_exif(broken: Capture) -> None:
    edit(broken.manifest("00"), "t40_p000", swap_files)
    with pytest.raises(InputError, match=r"EXIF says .* s, not .* s"):
        run_merge(broken, "00")


def test_a_swapped_exposure_is_seen_in_the_picture(broken: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where EXIF is silent: 1/250 and 1/4000 differ sixteen times."""
    monkeypatch.setattr("kinran.bracket.shots.read_raw", lambda path: replace(read_raw(path), seconds=0.0))
    edit(broken.manifest("00"), "t40_p000", swap_files)
    with pytest.raises(InputError, match="times as bright"):
        run_merge(broken, "00")


def test_an_exposure_twice(broken: Capture) -> None:
    def double(entry: dict[str, list[dict[str, object]]]) -> None:
        entry["frames"][1] = entry["frames"][0]

    edit(broken.manifest("00"), "t40_p000", double)
    with pytest.raises(InputError, match="stands twice"):
        run_merge(broken, "00")


def test_one_exposure_less_merges(broken: Capture, capture: Capture, stack: Stack) -> None:
    edit(broken.manifest("00"), "t40_p000", lambda entry: entry["frames"].pop(2))
    shots = {shot.shot: shot for shot in read_manifest(broken.manifest("00"), broken.plan)}
    camera = read_calibration(broken.folder / "calibration.json").camera
    assert camera is not None
    seen = merge_bracket(read_bracket(shots["t40_p000"]), camera)
    whole = {shot.shot: shot for shot in read_manifest(capture.manifest("00"), capture.plan)}
    expected = merge_bracket(read_bracket(whole["t40_p000"]), camera)
    good = ~seen.has(SATURATED | HOT)
    assert seen.value[good].sum() == pytest.approx(expected.value[good].sum(), rel=2e-3)


def test_a_light_without_a_shot(broken: Capture) -> None:
    value = json.loads(broken.manifest("00").read_text())
    value["shots"] = [shot for shot in value["shots"] if shot["shot"] != "t40_p000"]
    broken.manifest("00").write_text(json.dumps(value))
    with pytest.raises(InputError, match="has no shot of light 't40_p000'"):
        run_merge(broken, "00")


def test_a_manifest_of_another_plan(broken: Capture) -> None:
    value = json.loads(broken.manifest("00").read_text())
    broken.manifest("00").write_text(json.dumps({**value, "plan_sha256": "0" * 64}))
    with pytest.raises(InputError, match="belongs to another plan"):
        run_merge(broken, "00")


def test_a_lens_that_was_not_covered(broken: Capture) -> None:
    frame = broken.folder / "frames" / "dark_25.dng"
    shutil.copy(broken.folder / "frames" / "white_25.dng", frame)

    def taken_so(entry: dict[str, list[dict[str, str]]]) -> None:
        next(each for each in entry["frames"] if each["file"].endswith("dark_25.dng"))["sha256"] = sha256(frame)

    edit(broken.manifest("calibration"), "dark", taken_so)
    with pytest.raises(InputError, match="shot 'dark': is not dark"):
        run_calibrate(broken, broken.folder / "other.json")


def test_no_calibration_shots(broken: Capture) -> None:
    with pytest.raises(InputError, match="list 0 shots of kind 'dark'"):
        calibrate.main(calibrate.Inputs(broken.plan_path, (broken.manifest("00"),)), broken.folder / "other.json")


def test_a_group_that_was_not_merged(broken: Capture) -> None:
    run_merge(broken, "01")
    with pytest.raises(InputError, match="radiance/c/0/0/0/0: is missing"):
        run_stack(broken, 4)


@pytest.mark.parametrize(
    ("every", "message"), [(-1, "give 0 for none"), (1, "give 0 for none"), (40, "is left to hold out")]
)
def test_a_holdout_that_cannot_be(every: int, message: str) -> None:
    plan = plan_grid("swatch", (0, 20, 40), 4, (0.01,), 4)
    with pytest.raises(InputError, match=message):
        held_out([light.grid for light in plan.lights], every, "plan.json")
