"""RAW frames, as the planes of the sensor's colour filter array."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError

RAW = {".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef"}
"""Suffixes of RAW files."""
TURNS = {3: 2, 5: 1, 6: 3}
"""Quarter turns, counterclockwise, of LibRaw's codes for a camera that was held on its side."""
REC709_TO_XYZ = np.array(
    [[0.412453, 0.357580, 0.180423], [0.212671, 0.715160, 0.072169], [0.019334, 0.119193, 0.950227]]
)
"""Linear Rec. 709 to CIE XYZ under D65 (ITU-R BT.709)."""
LEAST_MASK = 256
"""Fewest masked sites above the picture on which the black level is measured: their mean has 1/16 of the read noise."""


@dataclass(frozen=True)
class RawFrame:
    """One RAW frame.

    Attributes
    ----------
    planes
        (4, y, x) uint16 counts of the sites R, G1 (in R's rows), G2 (in B's rows) and B; row 0 is v = 0.
    black
        Black level in counts: the mean under the sensor's mask where it has one, else the file's.
    masked
        Whether `black` was measured under a mask.
    white
        Saturation level in counts of the file, which is often wrong.
    seconds
        Nominal shutter time of EXIF in seconds; 0 if it is missing.
    iso, aperture
        ISO and aperture (f-number) of EXIF; 0 if they are missing.
    turns
        Quarter turns, counterclockwise, that bring the picture upright. The planes lie as the sensor does.
    """

    planes: NDArray[np.uint16]
    black: float
    masked: bool
    white: float
    seconds: float
    iso: float = 0.0
    aperture: float = 0.0
    turns: int = 0


def is_raw(path: Path) -> bool:
    """Return whether a file has the suffix of a RAW file."""
    return path.suffix.lower() in RAW


def raw_size(path: Path) -> tuple[int, int]:
    """Return width and height of the planes of a RAW file.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with _opened(path) as raw:
        return raw.sizes.width // 2, raw.sizes.height // 2


def camera_matrix(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the daylight white and the colour matrix that a RAW file states for its camera.

    Returns
    -------
    white : (3,) float
        R, G, B of daylight (D65), relative to G.
    to_rec709 : (3, 3) float
        Matrix from R, G, B relative to `white` to linear Rec. 709; the identity where the file states none.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    with _opened(path) as raw:
        from_xyz = np.array(raw.rgb_xyz_matrix[:3], float)
    if not from_xyz.any():
        return np.ones(3), np.eye(3)
    camera = from_xyz @ REC709_TO_XYZ
    white = camera.sum(1)
    return white / white[1], np.linalg.inv(camera / white[:, None])


def read_raw(path: Path) -> RawFrame:
    """Read a Bayer RAW file, neither demosaiced nor scaled.

    Raises
    ------
    InputError
        The file is missing, cut off, or not of a Bayer sensor.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; put it back or take it off the list")
    with _opened(path) as raw:
        if raw.raw_pattern is None or raw.raw_pattern.shape != (2, 2):
            raise InputError(f"{path}: is not of a Bayer sensor; give RAW frames of one")
        sizes, full = raw.sizes, raw.raw_image
        visible = raw.raw_image_visible
        height, width = (visible.shape[0] // 2) * 2, (visible.shape[1] // 2) * 2
        names = raw.color_desc.decode()
        planes = np.empty((4, height // 2, width // 2), np.uint16)
        for row in (0, 1):
            of_row = [names[k] for k in raw.raw_colors_visible[row, :2]]
            for column, name in enumerate(of_row):
                plane = {"R": 0, "G": 1 if "R" in of_row else 2, "B": 3}[name]
                planes[plane] = visible[row:height:2, column:width:2][::-1]
        border = full[: sizes.top_margin]
        masked = border.size >= LEAST_MASK
        black = _middle(border) if masked else float(np.mean(raw.black_level_per_channel))
        return RawFrame(
            planes,
            black,
            masked,
            float(raw.white_level),
            raw.other.shutter_speed,
            raw.other.iso_speed,
            raw.other.aperture,
            TURNS.get(sizes.flip, 0),
        )


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """Open a file with LibRaw, whose errors become `InputError`s that name the file."""
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            yield raw
    except (rawpy.LibRawError, KeyError) as error:
        message = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        raise InputError(f"{path}: cannot be read as RAW ({message}); copy it from the camera again") from None


def _middle(counts: NDArray[np.uint16]) -> float:
    """Return the mean of counts without hot sites: those over six standard deviations (1.4826 MAD) from the median."""
    away = np.abs(counts - np.median(counts))
    return float(counts[away <= 6 * 1.4826 * np.median(away) + 1].mean())
