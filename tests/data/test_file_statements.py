"""What a file says of its encoding without an ICC profile: chunks of PNG, and the colour space of EXIF."""

import struct
import zlib
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
from PIL import Image

from kinran.base.encoding import from_srgb, parse
from kinran.data.colour_profile import to_linear
from kinran.data.file_statements import statements
from kinran.data.photographs import read

CODES = np.random.default_rng(8).integers(0, 250, (10, 12, 3), dtype=np.uint8)


def png(path: Path, chunks: dict[bytes, bytes]) -> Path:
    """Write a PNG with chunks after its header."""
    Image.fromarray(CODES).save(path)
    data = path.read_bytes()
    extra = b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))
        for name, body in chunks.items()
    )
    path.write_bytes(data[:33] + extra + data[33:])
    return path


def jpeg(path: Path, space: int, index: str = "") -> Path:
    """Write a JPEG whose EXIF has a colour space and, if given, an index of interoperability."""
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0xA001] = space
    if index:
        exif.get_ifd(0x8769)[0xA005] = {1: index, 2: b"0100"}
    Image.fromarray(CODES).save(path, exif=exif, quality=100, subsampling=0)
    return path


@pytest.mark.parametrize(("gamma", "exponent"), [(100_000, 1.0), (55_556, 1.8)])
def test_the_gamma_of_a_png_is_honoured(tmp_path: Path, gamma: int, exponent: float) -> None:
    path = png(tmp_path / "a.png", {b"gAMA": struct.pack(">I", gamma)})
    light = (CODES / 255.0) ** exponent
    assert np.abs(from_srgb(CODES / 255.0) - light).max() > 0.07  # what is taken without it
    np.testing.assert_allclose(read(path, parse("srgb")).value[::-1], light, atol=2e-3)


@pytest.mark.parametrize(
    ("chunks", "said"),
    [
        ({b"gAMA": struct.pack(">I", 45_455)}, "chunk gAMA"),
        ({b"gAMA": struct.pack(">I", 100_000), b"sRGB": b"\0"}, "chunk sRGB"),
        ({}, ""),
    ],
)
def test_srgb_stands_over_gamma(tmp_path: Path, chunks: dict[bytes, bytes], said: str) -> None:
    path = png(tmp_path / "a.png", chunks)
    assert statements(path).srgb == said
    np.testing.assert_allclose(read(path, parse("srgb")).value[::-1], from_srgb(CODES / 255.0), atol=1e-5)


def test_adobe_rgb_that_a_camera_states_in_its_exif(tmp_path: Path) -> None:
    """DCF has cameras write R03 and no profile; its colours are off by more than a tenth if taken for sRGB."""
    plain = read(jpeg(tmp_path / "plain.jpg", 1), parse("srgb")).value
    stated = read(jpeg(tmp_path / "adobe.jpg", 65535, "R03"), parse("srgb")).value
    with Image.open(tmp_path / "adobe.jpg") as image:
        codes = np.asarray(image, np.float32)[::-1] / 255
    np.testing.assert_allclose(stated, to_linear(codes, imagecodecs.cms_profile("adobergb")), atol=1e-5)
    assert np.abs(stated - plain).max() > 0.1
    assert statements(tmp_path / "plain.jpg").srgb == "EXIF"
    assert not statements(jpeg(tmp_path / "r98.jpg", 65535, "R98")).profile
