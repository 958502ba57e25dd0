"""EXR files with channels by name."""

from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from kinran.files import InputError, atomic

Image = NDArray[np.float32]


def write_exr(path: Path, channels: dict[str, Image], header: dict[str, object] | None = None) -> None:
    """Write float32 channels (y, x) under their names, losslessly compressed.

    OpenEXR scrambles arrays that are not contiguous without a word, so each is made contiguous and the file
    is read back before it takes its name.
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
    """Read all channels (y, x) of a one-part EXR as float32, by name."""
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


def write_rgb(path: Path, image: Image) -> None:
    """Write an image (y, x, 3) as channels R, G, B."""
    write_exr(path, {name: image[..., k] for k, name in enumerate("RGB")})
