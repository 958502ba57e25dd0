"""Coarse texels are what a wider lens would have measured."""

from pathlib import Path

import numpy as np
import pytest

from kinran.base.exr import read_exr
from kinran.base.files import InputError, write_json
from kinran.data.labels import Region, read_regions, write_labels, write_regions
from kinran.data.needed_regions import read_need
from kinran.data.radiance import DARK, HOT, SATURATED, SHIFTED, Radiance
from kinran.data.radiance_stack import Light, Metadata, Stack, write_metadata, write_shards
from kinran.data.shards import shard_path
from kinran.radiance.coarsen import Inputs, average, coarse_labels, main

LIGHTS = tuple(Light(f"l{i}", (0.0, 0.6, 0.8), held_out=i == 2) for i in range(11))


@pytest.fixture
def fabric(tmp_path: Path) -> Path:
    """A stack of 11 lights, 70 x 133 texels, whose left half is gold, and what a scene needs of it."""
    radiance = np.random.default_rng(1).random((11, 70, 133, 3)).astype(np.float32)
    for first in (0, 8):
        part = radiance[first : first + 8]
        write_shards(tmp_path / "radiance.zarr", first, Radiance.unflagged(part))
    metadata = Metadata(LIGHTS, 70, 133, 0.06, "", "", "camera", np.eye(3), {}, (0.0, 0.0, 700.0))
    write_metadata(tmp_path / "radiance.zarr", metadata)
    labels = np.repeat((np.arange(133) >= 64).astype(np.intp)[None], 70, 0)
    one = np.ones(labels.shape, np.float32)
    write_labels(tmp_path / "labels.exr", labels, one, labels, one)
    write_regions(
        tmp_path / "regions.json",
        [Region(k, name, int((labels == k).sum()), (0.5, 0.5, 0.5), 1.0) for k, name in enumerate(("gold", "red"))],
    )
    return tmp_path


def coarsen(folder: Path, factor: int) -> Stack:
    write_json(folder / "need.json", {"regions": [], "footprint": {"coarsest_factor": factor}})
    main(Inputs(folder, folder / "need.json"), folder / "coarse")
    return Stack.open(folder / "coarse" / "radiance.zarr")


def test_the_coarse_stack_is_the_mean(fabric: Path) -> None:
    fine, coarse = Stack.open(fabric / "radiance.zarr"), coarsen(fabric, 3)
    assert (coarse.height, coarse.width, coarse.texel_mm) == (23, 44, pytest.approx(0.18))
    assert (coarse.lights, coarse.camera_mm) == (fine.lights, fine.camera_mm)
    truth = fine.read_tile(0, 69, 0, 132).value.reshape(11, 23, 3, 44, 3, 3).mean((2, 4))
    np.testing.assert_allclose(coarse.read_tile(0, 23, 0, 44).value, truth, atol=1e-3)  # half floats
    label = read_exr(fabric / "coarse" / "labels.exr")
    np.testing.assert_array_equal(label["label"][0], np.arange(44) >= 21)
    assert label["membership"][0, 21] == pytest.approx(2 / 3)
    assert label["second"][0, 21] == 0
    assert [region.texels for region in read_regions(fabric / "coarse" / "regions.json")] == [21 * 23, 23 * 23]


def test_texels_that_are_needed_stay_and_take_no_room(fabric: Path) -> None:
    fine, same = Stack.open(fabric / "radiance.zarr"), coarsen(fabric, 1)
    np.testing.assert_array_equal(same.read_tile(0, 70, 0, 133).value, fine.read_tile(0, 70, 0, 133).value)
    assert shard_path(same.path, "radiance", 1).samefile(shard_path(fine.path, "radiance", 1))
    coarsen(fabric, 2)  # nothing of the links is written through
    assert fine.read_tile(0, 70, 0, 133).value.shape == (11, 70, 133, 3)


def test_flags_say_of_a_block_what_holds_for_it() -> None:
    flags = np.zeros((1, 2, 8, 3), np.uint8)
    flags[0, 0, 0] = SATURATED | HOT  # a defect says nothing of the light
    flags[0, 0, 2] = SATURATED
    flags[0, :, 4:6] = HOT
    flags[0, :, 6:8] = DARK
    flags[0, 0, 7] |= SHIFTED
    radiance = np.ones((1, 2, 8, 3), np.float32)
    radiance[0, 0, 0] = 9
    mean = average(Radiance(radiance, flags), 2)
    np.testing.assert_array_equal(mean.flags[0, 0, :, 0], [0, SATURATED, HOT, DARK | SHIFTED])
    np.testing.assert_array_equal(mean.value, 1)


def test_a_texel_of_two_threads_counts_for_both() -> None:
    channels = {
        "label": np.array([[0, 0], [1, 1]], np.float32),
        "second": np.array([[1, 1], [1, 1]], np.float32),
        "membership": np.array([[0.5, 0.6], [1, 1]], np.float32),
        "confidence": np.ones((2, 2), np.float32),
    }
    found = coarse_labels(channels, 2)
    assert (found["labels"][0, 0], found["second"][0, 0]) == (1, 0)
    assert found["membership"][0, 0] == pytest.approx((0.5 + 0.4 + 2) / 4)


def test_bad_input_is_told(fabric: Path) -> None:
    with pytest.raises(InputError, match="move the camera closer"):
        coarsen(fabric, 71)
    write_json(fabric / "need.json", {"regions": [], "footprint": {}})
    with pytest.raises(InputError, match=r"\(footprint: Object missing required field `coarsest_factor`\)"):
        read_need(fabric / "need.json")
