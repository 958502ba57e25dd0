"""Nominal exposure times: what a camera wrote into a file, and what a person wrote into its name."""

import re
from pathlib import Path

from PIL import Image as Pillow

from kinran.data.raw import is_raw

EXIF, TIME = 0x8769, 0x829A
"""Tags of EXIF: the directory of the exposure, and ExposureTime in it."""
IN_NAME = re.compile(r"_(?:(1)-(\d+)|(\d+(?:\.\d+)?)(m?))s(?=_|$)")
"""``_1-250s``, ``_0.004s`` or ``_4ms``, at the end of a name or before another ``_``."""


def nominal_seconds(path: Path) -> float:
    """Nominal exposure time in seconds, from EXIF or else from the file's name; 0 where neither has one."""
    return exif_seconds(path) or time_in_name(path.stem)


def exif_seconds(path: Path) -> float:
    """Nominal exposure time in seconds; 0 where the file has none."""
    if is_raw(path):
        return _raw(path)
    try:
        with Pillow.open(path) as image:
            tags = image.getexif()
            value = tags.get_ifd(EXIF).get(TIME, tags.get(TIME, 0))
            return max(float(value or 0), 0.0)
    except (OSError, SyntaxError, ValueError, TypeError, ZeroDivisionError):
        return 0.0


def _raw(path: Path) -> float:
    import rawpy

    try:
        with rawpy.imread(str(path)) as raw:
            return float(raw.other.shutter_speed)
    except rawpy.LibRawError:
        return 0.0


def time_in_name(stem: str) -> float:
    """Seconds in a file's name: ``cloth_25ms``, ``cloth_0.004s_2``, ``cloth_1-250s``; 0 if there are none."""
    found = IN_NAME.search(stem)
    if not found:
        return 0.0
    one, whole, number, milli = found.groups()
    return 1 / float(whole) if one else float(number) * (1e-3 if milli else 1.0)
