"""Photographs of all kinds, upright in memory, and what is wrong with the broken ones."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from kinran.base.encoding import parse
from kinran.base.exr import write_rgb
from kinran.base.files import InputError
from kinran.data.light import LpLight
from kinran.data.photographs import Crop, find, parse_crop, read, size
from kinran.data.radiance import SATURATED

SRGB, LINEAR = parse("srgb"), parse("linear")
VALUES = np.random.default_rng(1).integers(0, 256, (6, 9, 3), dtype=np.uint8)


def test_eight_bit_png_is_decoded_exactly_and_turned_so_that_row_0_is_the_bottom(tmp_path: Path) -> None:
    Image.fromarray(VALUES).save(tmp_path / "a.png")
    photograph = read(tmp_path / "a.png", SRGB)
    np.testing.assert_allclose(photograph.value, SRGB.decode(VALUES[::-1] / 255), atol=1e-6)
    assert photograph.has(SATURATED).sum() == (VALUES >= 254).sum()


@pytest.mark.parametrize("suffix", ["tif", "png"])
def test_sixteen_bit(tmp_path: Path, suffix: str) -> None:
    values = (np.arange(54, dtype=np.uint16) * 1000).reshape(6, 9)
    path = tmp_path / f"a.{suffix}"
    if suffix == "tif":
        values = values[..., None].repeat(3, -1)
        tifffile.imwrite(path, values)
    else:
        Image.fromarray(values).save(path)
    light = read(path, LINEAR).value
    expected = values if values.ndim == 3 else values[..., None].repeat(3, -1)
    np.testing.assert_allclose(light, expected[::-1] / 65535, atol=1e-6)


def test_exr_is_taken_as_it_is(tmp_path: Path) -> None:
    image = np.random.default_rng(2).normal(size=(4, 5, 3)).astype(np.float32) * 10
    write_rgb(tmp_path / "a.exr", image)
    photograph = read(tmp_path / "a.exr", SRGB)
    np.testing.assert_array_equal(photograph.value, image[::-1])
    assert not photograph.flags.any()
    assert size(tmp_path / "a.exr") == (5, 4)


def test_crop_counts_from_the_top_left(tmp_path: Path) -> None:
    Image.fromarray(VALUES).save(tmp_path / "a.png")
    light = read(tmp_path / "a.png", LINEAR, Crop(2, 1, 4, 3)).value
    np.testing.assert_allclose(light, VALUES[1:4, 2:6][::-1] / 255, atol=1e-6)
    with pytest.raises(InputError, match="too small for the crop 6,0,4,3"):
        read(tmp_path / "a.png", LINEAR, Crop(6, 0, 4, 3))


@pytest.mark.parametrize("text", ["1,2,3", "a,b,c,d", "-1,0,4,4", "0,0,0,4", "0,0,4.5,4"])
def test_bad_crops(text: str) -> None:
    with pytest.raises(InputError, match="crop"):
        parse_crop(text)


def test_sixteen_bit_colour_png_keeps_its_bits(tmp_path: Path) -> None:
    values = np.random.default_rng(4).integers(0, 65536, (6, 9, 3), dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(values))
    np.testing.assert_allclose(read(tmp_path / "a.png", LINEAR).value, values[::-1] / 65535, atol=1e-6)


@pytest.mark.parametrize("mode", ["L", "LA", "RGBA", "P"])
def test_other_kinds_of_png(tmp_path: Path, mode: str) -> None:
    picture = Image.fromarray(VALUES).convert(mode)
    picture.save(tmp_path / "a.png")
    expected = np.asarray(picture.convert("RGB"))[::-1] / 255
    np.testing.assert_allclose(read(tmp_path / "a.png", LINEAR).value, expected, atol=1e-6)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_truncated_files_are_named(tmp_path: Path, suffix: str) -> None:
    big = np.random.default_rng(3).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    path = tmp_path / f"a.{suffix}"
    if suffix == "tif":
        tifffile.imwrite(path, big)
    else:
        Image.fromarray(big).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputError, match=rf"a\.{suffix}: is truncated or broken"):
        read(path, SRGB)


def test_find_does_not_mind_another_suffix_but_minds_two(tmp_path: Path) -> None:
    (tmp_path / "a.png").touch()
    assert find(tmp_path, [LpLight("a", (0, 0, 1), "a.jpg")]) == {"a": tmp_path / "a.png"}
    (tmp_path / "a.tif").touch()
    with pytest.raises(InputError, match="keep one image for each light"):
        find(tmp_path, [LpLight("a", (0, 0, 1), "a.jpg")])
    assert find(tmp_path, [LpLight("a", (0, 0, 1), "a.tif")])["a"].suffix == ".tif"
    with pytest.raises(InputError, match=r"b\.jpg: no such image"):
        find(tmp_path, [LpLight("b", (0, 0, 1), "b.jpg")])
    with pytest.raises(InputError, match="no such folder"):
        find(tmp_path / "none", [])


def test_find_does_not_mind_capitals_and_looks_into_the_folder_that_is_named(tmp_path: Path) -> None:
    (tmp_path / "A.JPG").touch()
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "b.jpg").touch()
    lights = [LpLight("a", (0, 0, 1), "a.jpg", "photos"), LpLight("b", (0, 0, 1), "b.jpg", "photos")]
    assert find(tmp_path, lights) == {"a": tmp_path / "A.JPG", "b": tmp_path / "photos" / "b.jpg"}
    (tmp_path / "a.jpg").touch()
    assert find(tmp_path, lights[:1]) == {"a": tmp_path / "a.jpg"}
