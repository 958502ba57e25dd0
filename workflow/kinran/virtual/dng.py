"""Write Bayer DNG files, as a camera does: uncompressed, with an optical-black border and EXIF."""

import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray

MODEL = "Virtual"
"""Camera model in EXIF."""
RGGB = (0, 1, 1, 2)
"""Colours (0 red, 1 green, 2 blue) of the first two sites of the first two rows."""
ISO, APERTURE = 100, Fraction(8)
"""Settings that a frame states if it is not told others: made up."""
EXIF, PLACEHOLDER = 34665, 34664
"""Tag of the pointer to the directory of the exposure, and one that tifffile lets through in its place."""
COLOUR_MATRIX = (7054, -1501, -990, -8156, 15544, 2812, -1278, 1414, 7796)
"""XYZ (D65) to camera, × 10⁴ as in DNG, of the profile of a common APS-C camera. Nothing in Kinran reads it."""


@dataclass(frozen=True)
class Tags:
    """What a frame says of itself.

    Attributes
    ----------
    seconds
        Nominal shutter time in seconds, for EXIF.
    border, columns
        Rows at the top and columns at the left that a mask covers.
    black, white
        Levels in counts; the black one may have a fraction, or be that of each of the first two sites of the first two
        rows.
    when
        EXIF date, ``YYYY:MM:DD HH:MM:SS``.
    pattern
        Colours (0 red, 1 green, 2 blue) of the first two sites of the first two rows under the mask.
    orientation
        EXIF's orientation: 1 upright; 3, 6 and 8 for a camera that was turned.
    iso, aperture
        ISO and aperture (f-number).
    """

    seconds: Fraction
    border: int
    black: float | tuple[float, float, float, float]
    white: int
    when: str
    pattern: tuple[int, int, int, int] = RGGB
    orientation: int = 1
    iso: int = ISO
    aperture: Fraction = APERTURE
    columns: int = 0


def write_dng(path: Path, bayer: NDArray[np.uint16], said: Tags, encoded: bytes | None = None) -> None:
    """Write one frame of a Bayer sensor.

    Parameters
    ----------
    path
        File to write; not atomic.
    bayer : (h, w) uint16
        Counts, top row first.
    said
        Tags of the frame.
    encoded
        The counts as a lossless JPEG; None to store them uncompressed.
    """
    height, width = bayer.shape
    matrix = [part for value in COLOUR_MATRIX for part in (value, 10_000)]
    tags: list[tuple[int, str, int, Any, bool]] = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),  # DNGVersion
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),  # DNGBackwardVersion
        (50708, "s", 0, MODEL, True),  # UniqueCameraModel
        (271, "s", 0, "Kinran", True),  # Make
        (272, "s", 0, MODEL, True),
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, bytes(said.pattern), True),  # CFAPattern
        (50711, "H", 1, 1, True),  # CFALayout: rectangular
        (50829, "I", 4, (said.border, said.columns, height, width), True),  # ActiveArea
        *_black_tags(said.black),
        (50717, "H", 1, said.white, True),
        (50721, "2i", 9, matrix, True),  # ColorMatrix1
        (50728, "2I", 3, [1, 1, 1, 1, 1, 1], True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
        (274, "H", 1, said.orientation, True),
        (33434, "2I", 1, (said.seconds.numerator, said.seconds.denominator), True),
        (34855, "H", 1, said.iso, True),
        (33437, "2I", 1, (said.aperture.numerator, said.aperture.denominator), True),
        (36867, "s", 0, said.when, True),
        (306, "s", 0, said.when, True),
        (PLACEHOLDER, "I", 1, 0, True),
    ]
    how = {
        "photometric": 32803,
        "planarconfig": 1,
        "rowsperstrip": height,
        "extratags": tags,
        "metadata": None,
        "software": None,
    }
    if encoded is None:
        tifffile.imwrite(path, bayer, **how)
    else:
        with tifffile.TiffWriter(path) as file:
            file.write(iter([encoded]), shape=bayer.shape, dtype=np.uint16, compression=7, **how)
    _append_exif(path, said)


def _black_tags(black: float | tuple[float, float, float, float]) -> list[tuple[int, str, int, Any, bool]]:
    """Return the tags of a black level, or of one for each site of a cell."""
    if isinstance(black, tuple):
        parts = [part for level in black for part in Fraction(level).limit_denominator(1000).as_integer_ratio()]
        return [(50713, "H", 2, (2, 2), True), (50714, "2I", 4, parts, True)]
    if black == int(black):
        return [(50714, "H", 1, int(black), True)]
    return [(50714, "2I", 1, Fraction(black).limit_denominator(1000).as_integer_ratio(), True)]


def _append_exif(path: Path, said: Tags) -> None:
    """Append the directory of the exposure, where LibRaw looks for the ISO; tifffile refuses to write one."""
    data = bytearray(path.read_bytes())
    with tifffile.TiffFile(path) as file:
        place = file.pages[0].tags[PLACEHOLDER].offset
    start = len(data) + len(data) % 2
    data += bytes(len(data) % 2)
    values = start + 2 + 12 * 4 + 4
    fractions = [*_pair(said.seconds), *_pair(said.aperture)]
    when = said.when.encode() + b"\0"
    data += struct.pack("<H", 4)
    data += struct.pack("<HHII", 33434, 5, 1, values)
    data += struct.pack("<HHII", 33437, 5, 1, values + 8)
    data += struct.pack("<HHII", 34855, 3, 1, said.iso)
    data += struct.pack("<HHII", 36867, 2, len(when), values + 16)
    data += struct.pack("<I4I", 0, *fractions) + when
    struct.pack_into("<HHII", data, place, EXIF, 4, 1, start)
    path.write_bytes(data)


def _pair(value: Fraction) -> tuple[int, int]:
    return value.numerator, value.denominator
