"""Shards are read as Zarr reads them."""

from pathlib import Path

import numpy as np
import pytest
import zarr

from kinran.base.files import read_json
from kinran.data.light import Light
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Metadata, Stack, write_metadata, write_shards
from kinran.data.shard_file import as_declared, read_box
from kinran.data.shards import shard_path

SIZE = (150, 131)
LIGHTS = 11


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stack")
    rng = np.random.default_rng(0)
    value = rng.random((LIGHTS, *SIZE, 3)).astype(np.float32)
    write_shards(path, 0, Radiance(value, rng.integers(0, 32, value.shape).astype(np.uint8)))
    lights = tuple(Light(str(k), (0.0, 0.0, 1.0)) for k in range(LIGHTS))
    write_metadata(path, Metadata(lights, *SIZE, None, "", "", "camera", np.eye(3), {}))
    return path


@pytest.mark.parametrize(
    "box", [(0, 150, 0, 131), (0, 64, 64, 128), (63, 65, 127, 131), (100, 101, 5, 6), (9, 9, 0, 3)]
)
def test_boxes_are_those_of_zarr(folder: Path, box: tuple[int, int, int, int]) -> None:
    y0, y1, x0, x1 = box
    group, stack = zarr.open_group(folder, mode="r"), Stack.open(folder)
    for lights in (range(LIGHTS), [9, 2], [], [3, 3, 10]):
        values, flags = stack.read_stored(*box, lights=list(lights))
        np.testing.assert_array_equal(values, group["radiance"][:, y0:y1, x0:x1][list(lights)])
        np.testing.assert_array_equal(flags, group["flags"][:, y0:y1, x0:x1][list(lights)])
        assert (values.dtype, flags.dtype) == (np.float16, np.uint8)


def test_what_metadata_declare(folder: Path) -> None:
    """Of another layout, Zarr reads the arrays."""
    metadata = read_json(folder / "radiance" / "zarr.json")
    assert as_declared(metadata, SIZE)
    assert not as_declared(metadata, (200, 131))
    other = metadata | {"codecs": [{"name": "bytes", "configuration": {"endian": "little"}}]}
    assert not as_declared(other, SIZE)
    assert not as_declared(metadata | {"data_type": "float32"}, SIZE)
    assert not as_declared({}, SIZE)


@pytest.mark.parametrize("kept", [0, 3, 40, 1000])
def test_a_shard_that_is_cut_off(folder: Path, tmp_path: Path, kept: int) -> None:
    path = tmp_path / "shard"
    path.write_bytes(shard_path(folder, "radiance", 0).read_bytes()[:kept])
    with pytest.raises((OSError, ValueError)):
        read_box(path, np.dtype(np.float16), SIZE, (0, 10, 0, 10), np.arange(8))
