"""The radiance stack on disk."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import zarr

from kinran.base.files import InputError
from kinran.data.radiance import DARK, HOT, SATURATED, Radiance
from kinran.data.radiance_stack import LARGEST, Light, Metadata, Stack, write_metadata, write_shards
from kinran.data.shards import group_shards, shard_path

RNG = np.random.default_rng(0)
LIGHTS = tuple(Light(f"l{i}", (0.0, 0.6, 0.8), (1.0, 2.0, 3.0), (1, i), i % 4 == 2) for i in range(19))


def write(folder: Path, samples: Radiance) -> None:
    write_shards(folder, 0, samples[:16])
    write_shards(folder, 16, samples[16:])
    height, width = samples.value.shape[1:3]
    noise = {"kind": "raw"}
    write_metadata(folder, Metadata(LIGHTS, height, width, 0.06, "srgb", "1,2,3,4", "camera", np.eye(3), noise))


@pytest.fixture
def samples() -> Radiance:
    radiance = RNG.random((19, 70, 66, 3)).astype(np.float32)
    radiance[4] = 0  # an empty chunk is a chunk, too
    return Radiance(radiance, RNG.integers(0, 16, radiance.shape).astype(np.uint8))


def test_what_is_written_is_read(tmp_path: Path, samples: Radiance) -> None:
    write(tmp_path / "s.zarr", samples)
    stack = Stack.open(tmp_path / "s.zarr")
    assert stack.lights == LIGHTS
    assert (stack.height, stack.width, stack.texel_mm) == (70, 66, 0.06)
    assert (stack.encoding, stack.crop, stack.colour) == ("srgb", "1,2,3,4", "camera")
    np.testing.assert_array_equal(stack.held_out, [i % 4 == 2 for i in range(19)])
    covered = np.zeros((70, 66), int)
    for y0, y1, x0, x1 in stack.tiles():
        seen = stack.read_tile(y0, y1, x0, x1)
        assert seen.value.dtype == np.float32
        np.testing.assert_array_equal(seen.value, samples.value.astype(np.float16)[:, y0:y1, x0:x1])
        np.testing.assert_array_equal(seen.flags, samples.flags[:, y0:y1, x0:x1])
        covered[y0:y1, x0:x1] += 1
    assert (covered == 1).all()
    some = stack.read_tile(3, 9, 60, 66, lights=[17, 2]).value
    np.testing.assert_array_equal(some, samples.value.astype(np.float16)[[17, 2], 3:9, 60:66])


def test_the_layout_is_plain_zarr(tmp_path: Path, samples: Radiance) -> None:
    write(tmp_path / "s.zarr", samples)
    group = zarr.open_group(tmp_path / "s.zarr", mode="r")
    assert group["radiance"].chunks == (8, 64, 64, 3)
    assert group["radiance"].shards == (8, 128, 128, 3)
    assert group["flags"].dtype == np.uint8
    files = sorted(str(p.relative_to(tmp_path / "s.zarr")) for p in tmp_path.rglob("*") if p.is_file())
    shards = [f"{name}/c/{k}/0/0/0" for name in ("radiance", "flags") for k in range(3)]
    assert files == sorted([*shards, "zarr.json", "radiance/zarr.json", "flags/zarr.json"])


def test_a_shard_replaces_the_old_one_whole(tmp_path: Path, samples: Radiance) -> None:
    write(tmp_path, samples)
    other = shard_path(tmp_path, "radiance", 1).read_bytes()
    brighter = samples.with_value(samples.value + 1)
    write_shards(tmp_path, 0, brighter[:8])
    assert shard_path(tmp_path, "radiance", 1).read_bytes() == other
    again = Stack.open(tmp_path).read_tile(0, 70, 0, 66, lights=range(8)).value
    np.testing.assert_array_equal(again, brighter.value[:8].astype(np.float16))


def test_half_floats_do_not_overflow(tmp_path: Path) -> None:
    radiance = np.full((2, 3, 3, 3), 0.5, np.float32)
    radiance[0, 0, 0] = 1e6, np.nan, -np.inf
    write_shards(tmp_path, 0, Radiance.unflagged(radiance))
    write_metadata(tmp_path, Metadata(LIGHTS[:2], 3, 3, None, "", "", "camera", np.eye(3), {}))
    seen = Stack.open(tmp_path).read_tile(0, 3, 0, 3)
    values, flags = seen.value, seen.flags
    np.testing.assert_array_equal(values[0, 0, 0], [LARGEST, 0, 0])
    np.testing.assert_array_equal(flags[0, 0, 0], [SATURATED, HOT, HOT])
    assert flags.sum() == SATURATED + 2 * HOT
    assert not (flags & DARK).any()


def test_lights_share_no_shard_with_another_job(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no whole shards"):
        write_shards(tmp_path, 4, Radiance.unflagged(np.zeros((8, 2, 2, 3), np.float32)))
    assert group_shards(range(8, 21), last=20) == [1]
    assert group_shards(range(8, 21), last=None) == [1, 2]


def test_damage_is_told(tmp_path: Path, samples: Radiance) -> None:
    with pytest.raises(InputError, match="is no radiance stack"):
        Stack.open(tmp_path / "none.zarr")
    write(tmp_path, samples)
    stack = Stack.open(tmp_path)
    shard = shard_path(tmp_path, "radiance", 1)
    shard.write_bytes(shard.read_bytes()[:5000])
    with pytest.raises(InputError, match="damaged"):
        stack.read_tile(0, 10, 0, 10)
    stack.read_tile(0, 10, 0, 10, lights=[3, 5])  # no other shard than theirs is decoded
    shard.unlink()
    with pytest.raises(InputError, match="radiance/c/1/0/0/0: is missing"):
        stack.read_tile(0, 10, 0, 10)
    (tmp_path / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    with pytest.raises(InputError, match="is damaged"):
        Stack.open(tmp_path)


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        write_shards(tmp_path / "file", 0, Radiance.unflagged(np.zeros((1, 2, 2, 3), np.float32)))


def test_a_flipped_bit_in_a_shard_is_an_error_that_names_it(tmp_path: Path, samples: Radiance) -> None:
    """Of 60 bits of each array, through the stack and through Zarr itself; 38 of 40 were read as other values once."""
    write(tmp_path, samples)
    for name in ("radiance", "flags"):
        shard = shard_path(tmp_path, name, 1)
        whole = shard.read_bytes()
        for bit in np.random.default_rng(2).integers(0, 8 * len(whole), 60).tolist():
            damaged = bytearray(whole)
            damaged[bit // 8] ^= 1 << bit % 8
            shard.write_bytes(damaged)
            with pytest.raises(InputError, match=rf"{name}/c/1/0/0/0: is damaged .*snakemake"):
                Stack.open(tmp_path).read_tile(0, 70, 0, 66, lights=range(8, 16))
            with pytest.raises(ValueError, match="checksum"):
                zarr.open_group(tmp_path, mode="r")[name][8:16]
        shard.write_bytes(whole)


def test_a_flipped_bit_in_the_metadata_is_an_error(tmp_path: Path, samples: Radiance) -> None:
    """Another direction of a light, another noise model: still JSON, and still a stack."""
    write(tmp_path, samples)
    for name in ("zarr.json", "radiance/zarr.json", "flags/zarr.json"):
        path = tmp_path / name
        whole = path.read_bytes()
        for old, new in ((b"8", b"9"), (b"0", b"1")):
            path.write_bytes(whole.replace(old, new, 1))
            with pytest.raises(InputError, match=rf"{name}: does not match its checksum"):
                Stack.open(tmp_path)
        path.write_bytes(whole)


def test_a_stack_without_checksums_is_read(tmp_path: Path, samples: Radiance) -> None:
    """As earlier versions wrote it, and as other programs write it."""
    write(tmp_path, samples)
    group = zarr.open_group(tmp_path, mode="r")
    values, attributes = {name: group[name][:] for name in ("radiance", "flags")}, dict(group.attrs)
    shutil.rmtree(tmp_path)
    old = zarr.create_group(tmp_path, attributes=attributes)
    for name, array in values.items():
        made = old.create_array(
            name, shape=array.shape, dtype=array.dtype, chunks=(8, 64, 64, 3), shards=(8, 128, 128, 3)
        )
        made[:] = array
    seen = Stack.open(tmp_path).read_tile(0, 70, 0, 66)
    np.testing.assert_array_equal(seen.value, values["radiance"])
    np.testing.assert_array_equal(seen.flags, values["flags"])
