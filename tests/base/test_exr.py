"""EXR by channel name, whatever the memory layout."""

import json
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from kinran.base.exr import read_channel, read_exr, read_exr_with_header, write_exr, write_rgb
from kinran.base.files import InputError
from kinran_bsdf import checksum

IMAGE = np.random.default_rng(0).random((7, 5, 3)).astype(np.float32)


@pytest.mark.parametrize(
    "image",
    [IMAGE, IMAGE[::-1], IMAGE[:, ::-1], IMAGE.transpose(1, 0, 2), np.asfortranarray(IMAGE), IMAGE[1:5, 2:4]],
    ids=["plain", "flipped", "mirrored", "transposed", "fortran", "crop"],
)
def test_no_layout_is_scrambled(tmp_path: Path, image: np.ndarray) -> None:
    write_rgb(tmp_path / "a.exr", image)
    channels = read_exr(tmp_path / "a.exr")
    np.testing.assert_array_equal(np.stack([channels[c] for c in "RGB"], -1), image)


def test_header_and_channel_names(tmp_path: Path) -> None:
    planes = {"lobe1.xx": IMAGE[..., 0], "label": IMAGE[..., 1]}
    write_exr(tmp_path / "a.exr", planes, {"kinran:model": "slope"})
    channels, header = read_exr_with_header(tmp_path / "a.exr")
    assert set(channels) == {"lobe1.xx", "label"}
    assert header["kinran:model"] == "slope"
    assert set(planes) == {"lobe1.xx", "label"}


def test_nan_and_infinity_survive(tmp_path: Path) -> None:
    plane = np.array([[np.nan, np.inf], [-1.0, 0.0]], np.float32)
    write_exr(tmp_path / "a.exr", {"Y": plane})
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr")["Y"], plane)


def test_truncated_and_missing(tmp_path: Path) -> None:
    write_rgb(tmp_path / "a.exr", IMAGE)
    whole = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "b.exr").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"b\.exr: cannot be read as EXR"):
        read_exr(tmp_path / "b.exr")
    with pytest.raises(InputError, match=r"b\.exr: cannot be read as EXR"):
        read_channel(tmp_path / "b.exr", "G", np.float32)
    for read in (read_exr, lambda path: read_channel(path, "G", np.float32)):
        with pytest.raises(InputError, match="no such file"):
            read(tmp_path / "c.exr")


def test_one_channel_takes_no_memory_for_the_others(tmp_path: Path) -> None:
    """Of four float channels of 300 × 500, one as 16-bit integers: the peak is far under their 2.4 MB."""
    planes = {name: np.random.default_rng(k).integers(0, 9, (300, 500)) for k, name in enumerate("abcd")}
    write_exr(tmp_path / "a.exr", {name: plane.astype(np.float32) for name, plane in planes.items()})
    tracemalloc.start()
    plane = read_channel(tmp_path / "a.exr", "c", np.uint16)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    np.testing.assert_array_equal(plane, planes["c"])
    assert plane.dtype == np.uint16
    assert peak < plane.nbytes + 0.3e6
    with pytest.raises(InputError, match="has no channel 'e'"):
        read_channel(tmp_path / "a.exr", "e", np.uint16)


def rewrite(path: Path, planes: dict[str, np.ndarray], header: dict[str, object]) -> None:
    """Write a file as another program would that keeps the attributes it does not know."""
    with OpenEXR.File(str(path)) as file:
        kept = {name: value for name, value in file.header().items() if name.startswith("kinran:")}
    attributes = {name: value for name, value in {**kept, **header}.items() if value is not None}
    with OpenEXR.File({**attributes, "type": OpenEXR.scanlineimage}, dict(planes)) as file:
        file.write(str(path))


def test_what_does_not_match_the_checksums_is_named(tmp_path: Path) -> None:
    """One float in its last bit, a channel gone or under another name, an attribute, the checksums themselves."""
    path = tmp_path / "a.exr"
    planes = {name: np.ascontiguousarray(IMAGE[..., k]) for k, name in enumerate("RGB")}
    other = planes["G"].copy()
    other[3, 2] = np.nextafter(other[3, 2], 2, dtype=np.float32)
    cases = (
        ({**planes, "G": other}, {}, "channel 'G' does not match the checksum"),
        ({"R": planes["R"], "G": planes["G"]}, {}, "has lost channel 'B'"),
        ({"R": planes["R"], "G": planes["G"], "C": planes["B"]}, {}, "channel 'C' does not match"),
        (planes, {"kinran:unit": "2"}, "an attribute does not match"),
        (planes, {"kinran:unit": None}, "an attribute does not match"),
        (planes, {"kinran:crc32": "{"}, "its attribute kinran:crc32 is damaged"),
    )
    for there, header, says in cases:
        write_exr(path, planes, {"kinran:unit": "1"})
        rewrite(path, there, header)
        with pytest.raises(InputError, match=rf"a\.exr: {says}"):
            read_exr(path)
    write_exr(path, planes)
    rewrite(path, {**planes, "G": other}, {})
    with pytest.raises(InputError, match="channel 'G' does not match"):
        read_channel(path, "G", np.float32)
    np.testing.assert_array_equal(read_channel(path, "R", np.float32), planes["R"])
    rewrite(path, {**planes, "G": other}, {"kinran:crc32": None})
    np.testing.assert_array_equal(read_exr(path)["G"], other)


def test_the_plugin_has_the_same_checksums(tmp_path: Path) -> None:
    """It is installed alone, so that it computes them itself."""
    planes = {"lobe1.xx": IMAGE[..., 0], "α": np.array([[np.nan, -0.0]], np.float32).repeat(2, 0)}
    for name, plane in planes.items():
        write_exr(tmp_path / "a.exr", {name: plane}, {"kinran:model": "slope", "kinran:": "Ö", "other": "1"})
        channels, header = read_exr_with_header(tmp_path / "a.exr")
        attributes = {key: str(value) for key, value in header.items() if key.startswith("kinran:")}
        assert json.loads(attributes[checksum.NAME]) == checksum.checksums(attributes, channels)
        assert checksum.damaged(attributes, channels) == ""
        assert checksum.damaged({**attributes, "kinran:model": "takeda2008"}, channels) == "a kinran: attribute"


@pytest.mark.parametrize("read", [read_exr, lambda path: read_channel(path, "G", np.float32)])
def test_text_that_is_no_text_any_more(tmp_path: Path, read: Callable[[Path], object]) -> None:
    """A flipped bit in the header, of a thousand: one reader gave an error that did not name the file."""
    path = tmp_path / "a.exr"
    write_rgb(path, np.zeros((4, 5, 3), np.float32))
    body = path.read_bytes()
    at = body.index(b'"G": "') + 7
    path.write_bytes(body[:at] + bytes([body[at] | 0x80]) + body[at + 1 :])
    with pytest.raises(InputError, match=r"a\.exr: "):
        read(path)
