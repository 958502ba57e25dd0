"""Photographs: decoded, never scaled; their sizes; what is held out."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from stages import make_stack

from kinran.base.files import InputError, write_json
from kinran.calibrate import colour_chart
from kinran.capture import ingest, ingest_group
from kinran.capture.photograph_set import Known, inspect
from kinran.data.capture_plan import read_plan, write_plan
from kinran.data.light import LpLight
from kinran.data.light_files import write_lp
from kinran.data.radiance import SATURATED
from kinran.data.radiance_stack import Stack
from kinran.data.shards import shard_path
from kinran.radiance import merge_group
from kinran.radiance import stack as stack_stage

COUNT = 20


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Twenty photographs: a ramp to the right and up, brighter with each light; a clipped corner."""
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(COUNT, 3)) * (1, 1, 0.3) + (0, 0, 1.5)
    lights = []
    for k, vector in enumerate(directions / np.linalg.norm(directions, axis=1, keepdims=True)):
        x, y = np.meshgrid(np.arange(20), np.arange(12))  # y from the top
        values = np.stack([5 * x + k, 10 * (11 - y) + k, np.full_like(x, 40 + k)], -1)
        values[0, 0] = 255
        Image.fromarray(values.astype(np.uint8)).save(tmp_path / f"p{k:02d}.png")
        x_, y_, z_ = (float(v) for v in vector)
        lights.append(LpLight(f"p{k:02d}", (x_, y_, abs(z_)), f"p{k:02d}.png"))
    write_lp(tmp_path / "set.lp", lights)
    return tmp_path


def run(folder: Path, encoding: str, crop: str = "", holdout: int = 4) -> Stack:
    plan = folder / "captures/set/plan.json"
    known = Known(encoding, crop)
    write_plan(plan, ingest.plan("set", inspect(folder, known, holdout), known))
    manifest = folder / "captures/set/groups/00.json"
    write_json(manifest, ingest_group.manifest(plan, "00", folder))
    return make_stack(folder, plan, manifest, holdout)


def test_linear_values_pass_unchanged(folder: Path) -> None:
    stack = run(folder, "linear")
    seen = stack.read_tile(0, 12, 0, 20)
    values, flags = seen.value, seen.flags
    assert values.shape == (COUNT, 12, 20, 3)
    ramp = (5 * np.arange(20) + np.arange(COUNT)[:, None]) / 255
    np.testing.assert_allclose(values[:, 3, :, 0], ramp, rtol=6e-4)  # half precision
    up = (10 * np.arange(12) + np.arange(COUNT)[:, None]) / 255
    np.testing.assert_allclose(values[:, :, 5, 1], up, rtol=6e-4)  # row 0 is the bottom
    assert (flags[:, 11, 0] & SATURATED).all()  # the corner at the top left
    assert (flags & SATURATED).sum() == COUNT * 3
    assert stack.encoding == "linear"
    np.testing.assert_allclose(stack.to_acescg, colour_chart.REC709_TO_ACESCG)


def test_srgb_is_decoded_and_cropped(folder: Path) -> None:
    stack = run(folder, "srgb", "4,2,8,6")
    seen = stack.read_tile(0, 6, 0, 8)
    values, flags = seen.value, seen.flags
    assert (stack.height, stack.width, stack.crop) == (6, 8, "4,2,8,6")
    encoded = (5 * 4 + 3) / 255  # column 4 under light 3
    assert values[3, 0, 0, 0] == pytest.approx(((encoded + 0.055) / 1.055) ** 2.4, rel=1e-3)
    assert values[3, 0, 0, 1] == pytest.approx((((10 * 4 + 3) / 255 + 0.055) / 1.055) ** 2.4, rel=1e-3)
    assert not (flags & SATURATED).any()


def test_every_fourth_is_held_out(folder: Path) -> None:
    held = run(folder, "linear", holdout=4).held_out
    np.testing.assert_array_equal(np.flatnonzero(held), [2, 6, 10, 14, 18])


def test_another_size_is_refused(folder: Path) -> None:
    run(folder, "linear")
    Image.fromarray(np.zeros((12, 21, 3), np.uint8)).save(folder / "p07.png")
    calibration, plan = folder / "calibration.json", folder / "captures/set/plan.json"
    inputs = merge_group.Inputs(plan, calibration, plan.parent / "groups/00.json")
    out = merge_group.Outputs(folder / "radiance.zarr")
    with pytest.raises(InputError, match=r"p07\.png: has other bytes than when it was taken"):
        merge_group.main(inputs, out)
    ingest_group.main(ingest_group.Inputs(folder, plan), inputs.manifest, ingest_group.Options(group="00"))
    with pytest.raises(InputError, match=r"p07\.png: gives 21 × 12 texels"):
        merge_group.main(inputs, out)
    (folder / "p07.png").write_bytes(b"")
    with pytest.raises(InputError, match=r"p07\.png"):
        merge_group.main(inputs, out)
    assert read_plan(plan).encoding == "linear"


def test_a_shard_that_changed_since_its_merge_is_refused(folder: Path) -> None:
    """By the digest in the receipt: another sound shard in its place, or a flipped bit."""
    run(folder, "linear")
    stack = folder / "radiance.zarr"
    inputs = stack_stage.Inputs(
        folder / "captures/set/plan.json",
        folder / "calibration.json",
        (folder / "captures/set/groups/00.json",),
        (folder / "00.json",),
    )
    stack_stage.main(inputs, stack)
    shard = shard_path(stack, "radiance", 1)
    whole = shard.read_bytes()
    for other in (shard_path(stack, "radiance", 0).read_bytes(), whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:]):
        shard.write_bytes(other)
        with pytest.raises(InputError, match=r"radiance/c/1/0/0/0: is not the shard that .*00\.json has the digest of"):
            stack_stage.main(inputs, stack)
    shard.unlink()
    with pytest.raises(InputError, match=r"radiance/c/1/0/0/0: is missing"):
        stack_stage.main(inputs, stack)


def test_another_set_at_the_same_path_is_not_taken_for_the_first(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where photographs are known by their path alone, the second set would get the radiance of the first."""
    monkeypatch.setenv("KINRAN_CACHE", str(tmp_path_factory.mktemp("shared")))
    monkeypatch.setattr(merge_group, "merge_shot", counted := Counted(merge_group.merge_shot))
    before = run(folder, "linear").read_tile(0, 12, 0, 20).value
    shutil.rmtree(folder / "radiance.zarr")
    again = run(folder, "linear").read_tile(0, 12, 0, 20).value
    assert counted.calls == COUNT
    np.testing.assert_array_equal(again, before)
    picture = np.array(Image.open(folder / "p03.png"))
    picture[5, 5] += 1
    Image.fromarray(picture).save(folder / "p03.png")
    after = run(folder, "linear").read_tile(0, 12, 0, 20).value
    assert counted.calls == 2 * COUNT
    assert np.argwhere((after != before).any(-1)).tolist() == [[3, 6, 5]]


class Counted:
    """A function whose calls are counted."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function, self.calls = function, 0

    def __call__(self, *args: Any) -> Any:
        self.calls += 1
        return self.function(*args)
