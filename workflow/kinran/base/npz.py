"""Arrays in an .npz file, whose ZIP has a CRC-32 of each."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError


def read_npz(path: Path, what: str = "file of arrays", remedy: str = "make it again") -> dict[str, NDArray[Any]]:
    """Read all arrays of an .npz file, by name, without pickles; `what` and `remedy` are words of its error.

    `numpy.load` reads as much of an array as its header asks for, and the ZIP's checksum is compared at its end alone;
    so each is read whole first. Nor is it told that an entry was swallowed by the comment of another.

    Raises
    ------
    InputError
        The file is missing, no ZIP of arrays, or damaged.
    """
    try:
        data = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(data)) as file:
            parts = {name.removesuffix(".npy"): io.BytesIO(file.read(name)) for name in file.namelist()}
        if len(parts) != int.from_bytes(data[-12:-10], "little"):  # as the end of the ZIP says
            raise ValueError("an array is missing")
        return {name: np.lib.format.read_array(part, allow_pickle=False) for name, part in parts.items()}
    except Exception as error:  # zipfile and zlib raise errors of many kinds on a broken file
        raise InputError(f"{path}: is no {what}; {remedy} ({error})") from None
