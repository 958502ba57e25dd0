"""Pictures of all kinds that cameras and programs write: told by their bytes, and read as their tags say."""

from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image
from raw_frames import expose, scene, write

from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.data.colour_profile import is_srgb
from kinran.data.light import LpLight
from kinran.data.photographs import find, read, size
from kinran.data.picture_kind import RAW, kind_of

SRGB, LINEAR = parse("srgb"), parse("linear")
RNG = np.random.default_rng(5)
CODES = RNG.integers(0, 256, (12, 16, 3), dtype=np.uint8)
ADOBE = imagecodecs.cms_profile(
    "rgb",
    whitepoint=[0.3127, 0.3290, 1.0],
    primaries=[0.64, 0.33, 1.0, 0.21, 0.71, 1.0, 0.15, 0.06, 1.0],
    gamma=563 / 256,
)
"""A profile with white, primaries and gamma of Adobe RGB (1998), Annex of its specification."""
ADOBE_TO_REC709 = np.array([[1.39836, -0.39836, 0.0], [0.0, 1.0, 0.0], [0.0, -0.04293, 1.04293]])
"""From its linear R, G, B to those of Rec. 709, which shares its white and two of its primaries."""


def tiff(path: Path, kind: str) -> np.ndarray:
    """Write a TIFF of a kind; returns the values of 8 bits that it shows."""
    grey = CODES[..., 0]
    if kind == "planes":
        tifffile.imwrite(path, np.moveaxis(CODES, -1, 0), photometric="rgb", planarconfig="separate")
    elif kind == "white is zero":
        tifffile.imwrite(path, 255 - grey, photometric="miniswhite")
        return grey[..., None].repeat(3, -1)
    elif kind == "palette":
        colours = RNG.integers(0, 256, (3, 256)).astype(np.uint16) * 257
        tifffile.imwrite(path, grey, photometric="palette", colormap=colours)
        return (np.moveaxis(colours, 0, -1)[grey] // 257).astype(np.uint8)
    elif kind == "inks":
        inks = np.concatenate([255 - CODES, np.zeros_like(CODES[..., :1])], -1)
        tifffile.imwrite(path, inks, photometric="separated")
    elif kind == "thumbnail first":
        with tifffile.TiffWriter(path) as file:
            file.write(CODES[::4, ::4], photometric="rgb", subfiletype=1)
            file.write(CODES, photometric="rgb")
    elif kind == "alpha":
        tifffile.imwrite(
            path, np.concatenate([CODES, CODES[..., :1]], -1), photometric="rgb", extrasamples=["unassalpha"]
        )
    return CODES


@pytest.mark.parametrize("kind", ["planes", "white is zero", "palette", "inks", "thumbnail first", "alpha"])
def test_tiff_as_tagged(tmp_path: Path, kind: str) -> None:
    shown = tiff(tmp_path / "a.tif", kind)
    assert size(tmp_path / "a.tif") == (16, 12)
    np.testing.assert_allclose(read(tmp_path / "a.tif", LINEAR).value, shown[::-1] / 255, atol=1e-6)


def test_twelve_bits_of_sixteen(tmp_path: Path) -> None:
    """White is 4095 where a TIFF says that its samples have 12 bits."""
    values = RNG.integers(0, 4096, (12, 16, 3), dtype=np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", bitspersample=12)
    np.testing.assert_allclose(read(tmp_path / "a.tif", LINEAR).value, values[::-1] / 4095, atol=1e-6)


@pytest.mark.parametrize("suffix", ["webp", "bmp", "tga", "jp2"])
def test_kinds_without_loss(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a.{suffix}"
    if suffix == "jp2":
        path.write_bytes(imagecodecs.jpeg2k_encode(CODES, level=0))
    else:
        Image.fromarray(CODES).save(path, **({"lossless": True} if suffix == "webp" else {}))
    assert size(path) == (16, 12)
    np.testing.assert_allclose(read(path, LINEAR).value, CODES[::-1] / 255, atol=1e-6)


def test_a_kind_is_told_by_the_bytes_and_not_by_the_name(tmp_path: Path) -> None:
    Image.fromarray(CODES).save(tmp_path / "a.png")
    (tmp_path / "a.png").rename(tmp_path / "a.jpg")
    np.testing.assert_allclose(read(tmp_path / "a.jpg", LINEAR).value, CODES[::-1] / 255, atol=1e-6)
    write(tmp_path / "b.dng", expose(scene(8), 1 / 25, RNG), 25)
    (tmp_path / "b.dng").rename(tmp_path / "b.tif")
    assert kind_of(tmp_path / "b.tif") == RAW


@pytest.mark.parametrize(("start", "name"), [(b"\0\0\0\x18ftypheic", "HEIC"), (b"8BPS\0\1", "Photoshop"), (b"?", "")])
def test_a_kind_that_is_not_read_is_named(tmp_path: Path, start: bytes, name: str) -> None:
    (tmp_path / "a.heic").write_bytes(start + bytes(64))
    says = f"is a {name or 'HEIC'} file, which is not read; convert it to TIFF or PNG"
    with pytest.raises(InputError, match=says):
        read(tmp_path / "a.heic", SRGB)
    assert find(tmp_path, [LpLight("a", (0, 0, 1), "a.jpg")])["a"].suffix == ".heic"


def test_what_macos_keeps_beside_a_picture_is_none(tmp_path: Path) -> None:
    Image.fromarray(CODES).save(tmp_path / "a.png")
    (tmp_path / "._a.png").write_bytes(b"\0\5\x16\7")
    assert find(tmp_path, [LpLight("a", (0, 0, 1), "a.png")]) == {"a": tmp_path / "a.png"}


@pytest.mark.parametrize("bits", [8, 16])
def test_an_embedded_profile_is_honoured(tmp_path: Path, bits: int) -> None:
    """Adobe RGB becomes linear Rec. 709, to 1e-3; taken for sRGB, it is off by more than a tenth of white."""
    values = (CODES if bits == 8 else CODES.astype(np.uint16) * 257).clip(None, 2**bits - 1)
    if bits == 8:
        Image.fromarray(values).save(tmp_path / "a.png", icc_profile=ADOBE)
    else:
        tifffile.imwrite(tmp_path / "a.png", values, photometric="rgb", iccprofile=ADOBE)
    expected = (values[::-1] / (2**bits - 1)) ** (563 / 256) @ ADOBE_TO_REC709.T
    np.testing.assert_allclose(read(tmp_path / "a.png", SRGB).value, expected, atol=1e-3)
    assert np.abs(SRGB.decode(values[::-1] / (2**bits - 1)) - expected).max() > 0.1


def test_srgb_is_known_as_such(tmp_path: Path) -> None:
    assert is_srgb(imagecodecs.cms_profile("srgb"))
    assert not is_srgb(ADOBE)
    Image.fromarray(CODES).save(tmp_path / "a.png", icc_profile=imagecodecs.cms_profile("srgb"))
    np.testing.assert_array_equal(read(tmp_path / "a.png", SRGB).value, SRGB.decode(CODES[::-1] / np.float32(255)))
