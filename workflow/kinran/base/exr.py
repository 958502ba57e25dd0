"""EXR files with channels by name, and with a checksum in the header that tells flipped bits.

The attribute ``kinran:crc32`` is JSON: for each channel the CRC-32 of its size as text and its float32 values, and
under ``kinran:`` that of all other attributes of this prefix that are text. `kinran_bsdf.checksum` writes and checks
the same in the plugin, which is installed alone; a test holds the two together.
"""

import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

import Imath
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from kinran.base.files import InputError, atomic

Image = NDArray[np.float32]
S = TypeVar("S", bound=np.generic)

CRC32 = "kinran:crc32"
"""Attribute with the checksums."""
PREFIX = "kinran:"
"""Prefix of the attributes that have a checksum, and the key of their checksum."""
ROWS = 64
"""Rows of a single channel that are read at a time, so that the file's other channels, decoded with them, take little
memory."""


def write_exr(path: Path, channels: dict[str, Image], header: dict[str, object] | None = None) -> None:
    """Write float32 channels (y, x) under their names, losslessly compressed, with their checksums in the header.

    OpenEXR scrambles arrays that are not contiguous without an error, so each is made contiguous and the file
    is read back before it takes its name.

    Raises
    ------
    InputError
        The folder cannot be written to.
    OSError
        The file reads back changed.
    """
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    texts = _texts(header or {})
    sums = {PREFIX: _of_attributes(texts), **{name: _of_channel(plane) for name, plane in sorted(planes.items())}}
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(header or {})}
    attributes[CRC32] = json.dumps(sums)
    with atomic(path) as temporary:
        with OpenEXR.File(attributes, dict(planes)) as file:  # it changes the dictionary that it is given
            file.write(str(temporary))
        for name, plane in read_exr(temporary).items():
            if not np.array_equal(plane, planes[name], equal_nan=True):
                raise OSError(f"{path}: channel {name} reads back changed; is the disk full?")


def read_exr(path: Path) -> dict[str, Image]:
    """Read all channels (y, x) of a one-part EXR as float32, by name; errors as in `read_exr_with_header`."""
    return read_exr_with_header(path)[0]


def read_exr_with_header(path: Path) -> tuple[dict[str, Image], dict[str, object]]:
    """Read all channels (y, x) and the header of a one-part EXR, and check its checksums where it has some.

    Raises
    ------
    InputError
        The file is missing, truncated or no EXR, or does not match its checksums.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(c.pixels, np.float32) for name, c in file.channels().items()}
            header = dict(file.header())
    except Exception as error:  # OpenEXR raises bare RuntimeError and ValueError
        raise InputError(f"{path}: cannot be read as EXR ({error})") from None
    texts = _texts(header)
    if stated := _stated(path, texts):
        _check(path, stated, {PREFIX: _of_attributes(texts), **{n: _of_channel(c) for n, c in channels.items()}})
        if missing := [name for name in stated if name != PREFIX and name not in channels]:
            raise InputError(f"{path}: has lost channel '{missing[0]}'; restore it or make it again")
    return channels, header


def read_channel(path: Path, name: str, dtype: type[S]) -> NDArray[S]:
    """Read one channel (y, x) of an EXR as another type; a few rows at a time, so that the others take no memory.

    Raises
    ------
    InputError
        The file is missing, truncated, no EXR or has no such channel, or the channel does not match its checksum.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        file = OpenEXR.InputFile(str(path))  # its successor reads all channels or none
        header = file.header()
        missing = name not in header["channels"]
        window = header["dataWindow"]
        height, width = window.max.y - window.min.y + 1, window.max.x - window.min.x + 1
        plane = np.empty((0 if missing else height, width), dtype)
        found = _of_size(height, width)
        for y in range(0, len(plane), ROWS):
            last = min(y + ROWS, height) - 1
            kind = Imath.PixelType(Imath.PixelType.FLOAT)
            row = file.channel(name, kind, window.min.y + y, window.min.y + last)
            plane[y : last + 1] = np.frombuffer(row, np.float32).reshape(-1, width)
            found = zlib.crc32(row, found)
        file.close()
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as EXR ({error})") from None
    if missing:
        raise InputError(f"{path}: has no channel '{name}'; make it again")
    texts = _texts(header)
    if stated := _stated(path, texts):
        _check(path, stated, {PREFIX: _of_attributes(texts), name: f"{found:08x}"})
    return plane


def write_rgb(path: Path, image: Image) -> None:
    """Write an image (y, x, 3) as channels R, G, B."""
    write_exr(path, {name: image[..., k] for k, name in enumerate("RGB")})


def _texts(header: Mapping[str, object]) -> dict[str, str]:
    """Return the attributes of a header that are text and begin with `PREFIX`; the older reader gives them as bytes."""
    texts = {
        name: value.decode(errors="replace") if isinstance(value, bytes) else value for name, value in header.items()
    }
    return {name: text for name, text in texts.items() if name.startswith(PREFIX) and isinstance(text, str)}


def _of_attributes(texts: Mapping[str, str]) -> str:
    lines = "".join(f"{name}={texts[name]}\n" for name in sorted(texts) if name != CRC32)
    return f"{zlib.crc32(lines.encode()):08x}"


def _of_size(height: int, width: int) -> int:
    return zlib.crc32(f"{height} {width}\n".encode())


def _of_channel(plane: Image) -> str:
    return f"{zlib.crc32(np.ascontiguousarray(plane, '<f4').data, _of_size(*plane.shape)):08x}"


def _stated(path: Path, texts: Mapping[str, str]) -> dict[str, str]:
    """Return the checksums that a file states, by name; none where it was written by another program."""
    try:
        return dict(json.loads(texts.get(CRC32, "{}")))
    except (ValueError, TypeError):
        raise InputError(f"{path}: its attribute {CRC32} is damaged; restore it or make it again") from None


def _check(path: Path, stated: Mapping[str, str], found: Mapping[str, str]) -> None:
    """Check the checksums of attributes and channels, by name, against those that the file states."""
    for name, checksum in found.items():
        if stated.get(name) != checksum:
            what = "an attribute" if name == PREFIX else f"channel '{name}'"
            raise InputError(
                f"{path}: {what} does not match the checksum in its header; restore it or make it again, or remove the"
                f" attribute {CRC32} if it was edited on purpose"
            )
