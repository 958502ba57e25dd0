"""One EXR a light: colours, metadata, and what happens to values that half floats cannot hold."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from kinran.base.exr import read_exr_with_header, write_exr
from kinran.base.files import InputError
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, Stack, write_metadata, write_shards
from kinran.radiance import export

MATRIX = np.array([[0.9, 0.1, 0.0], [-0.2, 1.3, -0.1], [0.0, 0.1, 0.9]])


@pytest.fixture
def stack(tmp_path: Path) -> Stack:
    rng = np.random.default_rng(0)
    radiance = rng.random((8, 20, 30, 3)).astype(np.float32)
    radiance[2, 0, 0] = 0, 0, 60_000
    radiance[2, 1, 1] = 5, 0, 0
    lights = tuple(Light(f"l{k}", (0.0, 0.6, 0.8), (0.0, 360.0, 480.0)) for k in range(8))
    write_shards(tmp_path / "s.zarr", 0, Radiance.unflagged(radiance))
    noise = {"kind": "raw", "seconds": [0.04, 0.001]}
    camera = (0.0, 0.0, 600.0)
    metadata = Metadata(lights, 20, 30, 0.1, "", "", "camera", MATRIX, noise, camera)
    write_metadata(tmp_path / "s.zarr", metadata)
    return Stack.open(tmp_path / "s.zarr")


def run(stack: Stack, out: Path, lights: str = "") -> None:
    export.main(export.Inputs(stack.path), out, export.Options(lights))


def test_a_light_is_a_picture_in_acescg(tmp_path: Path, stack: Stack) -> None:
    """Upright, unclipped, negatives kept, to the precision of half floats; metadata that OpenEXR itself accepts."""
    run(stack, tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [f"l{k}.exr" for k in range(8)]
    channels, header = read_exr_with_header(tmp_path / "out/l2.exr")
    values = stack.read_tile(0, 20, 0, 30, [2]).value
    expected = (values[0].astype(float) @ MATRIX.T)[::-1]
    np.testing.assert_allclose(np.stack([channels[c] for c in "RGB"], -1), expected, rtol=6e-4, atol=1e-4)
    assert channels["G"][18, 1] == pytest.approx(-1.0, rel=1e-3)
    assert channels["B"].max() == pytest.approx(54_000, rel=1e-3)
    assert OpenEXR.checkColorMetadata(header) == 0
    assert header["colorInteropID"] == "lin_ap1_scene"
    np.testing.assert_allclose(header["chromaticities"], export.AP1, rtol=1e-6)
    np.testing.assert_allclose(header["kinran:direction"], [0, 0.6, 0.8], rtol=1e-6)
    np.testing.assert_allclose(header["kinran:positionMM"], [0, 360, 480])
    assert header["expTime"] == pytest.approx(0.04)
    assert header["kinran:unit"] == stack.unit == "pi T: a white diffuser that faces the lamp is 1"
    assert stack.camera_mm == (0.0, 0.0, 600.0)


def test_some_lights(tmp_path: Path, stack: Stack) -> None:
    run(stack, tmp_path / "out", "l1,l5")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"l1.exr", "l5.exr"}
    with pytest.raises(InputError, match="has no light 'l9'"):
        run(stack, tmp_path / "out", "l9")


@pytest.mark.parametrize("view", [np.s_[::-1], np.s_[:, ::2], np.s_[3:9, 2:7]])
def test_an_array_that_is_not_contiguous(tmp_path: Path, view: object) -> None:
    """OpenEXR scrambles it without a word (its issue 1929): what is written is read back."""
    plane = np.arange(600, dtype=np.float32).reshape(20, 30)
    for array in (plane[view], np.asfortranarray(plane), plane.T):  # type: ignore[index]
        write_exr(tmp_path / "x.exr", {"R": array})
        np.testing.assert_array_equal(read_exr_with_header(tmp_path / "x.exr")[0]["R"], array)
