"""EXR files with channels by name."""

from pathlib import Path
from typing import TypeVar

import Imath
import numpy as np
import OpenEXR
from numpy.typing import NDArray

from kinran.base.files import InputError, atomic

Image = NDArray[np.float32]
S = TypeVar("S", bound=np.generic)

ROWS = 64
"""Rows of a single channel that are read at a time, so that the file's other channels, decoded with them, take little
memory."""


def write_exr(path: Path, channels: dict[str, Image], header: dict[str, object] | None = None) -> None:
    """Write float32 channels (y, x) under their names, losslessly compressed.

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
    attributes = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **(header or {})}
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
    """Read all channels (y, x) and the header of a one-part EXR.

    Raises
    ------
    InputError
        The file is missing, truncated or no EXR.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: np.array(c.pixels, np.float32) for name, c in file.channels().items()}
            return channels, dict(file.header())
    except Exception as error:  # OpenEXR raises bare RuntimeError and ValueError
        raise InputError(f"{path}: cannot be read as EXR ({error})") from None


def read_channel(path: Path, name: str, dtype: type[S]) -> NDArray[S]:
    """Read one channel (y, x) of an EXR as another type; a few rows at a time, so that the others take no memory.

    Raises
    ------
    InputError
        The file is missing, truncated, no EXR or has no such channel.
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
        for y in range(0, len(plane), ROWS):
            last = min(y + ROWS, height) - 1
            kind = Imath.PixelType(Imath.PixelType.FLOAT)
            row = file.channel(name, kind, window.min.y + y, window.min.y + last)
            plane[y : last + 1] = np.frombuffer(row, np.float32).reshape(-1, width)
        file.close()
    except Exception as error:  # as above
        raise InputError(f"{path}: cannot be read as EXR ({error})") from None
    if missing:
        raise InputError(f"{path}: has no channel '{name}'; make it again")
    return plane


def write_rgb(path: Path, image: Image) -> None:
    """Write an image (y, x, 3) as channels R, G, B."""
    write_exr(path, {name: image[..., k] for k, name in enumerate("RGB")})
