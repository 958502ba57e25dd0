"""Nominal exposure times, from a file's EXIF or from its name."""

import re
from pathlib import Path

from PIL import Image as Pillow

from kinran.data.picture_kind import is_raw
from kinran.data.raw import raw_seconds

EXIF, TIME = 0x8769, 0x829A
"""Tags of EXIF: the directory of the exposure, and ExposureTime in it."""
IN_NAME = re.compile(r"_(?:(1)-(\d+)|(\d+(?:\.\d+)?)(m?))s(?=_|$)")
"""Pattern of a time in a name: ``_1-250s``, ``_0.004s`` or ``_4ms``, at its end or before another ``_``."""


def nominal_seconds(path: Path) -> float:
    """Return the nominal exposure time in seconds from EXIF, or else from the file's name; 0 where neither has one."""
    return exif_seconds(path) or time_in_name(path.stem)


def exif_seconds(path: Path) -> float:
    """Return the nominal exposure time in seconds of a file's EXIF; 0 where it has none."""
    if is_raw(path):
        return raw_seconds(path)
    try:
        with Pillow.open(path) as image:
            tags = image.getexif()
            value = tags.get_ifd(EXIF).get(TIME, tags.get(TIME, 0))
            return max(float(value or 0), 0.0)
    except (OSError, SyntaxError, ValueError, TypeError, ZeroDivisionError):
        return 0.0


def time_in_name(stem: str) -> float:
    """Return the seconds in a name such as ``cloth_25ms``, ``cloth_0.004s_2`` or ``cloth_1-250s``; 0 without any."""
    found = IN_NAME.search(stem)
    if not found:
        return 0.0
    one, whole, number, milli = found.groups()
    return 1 / float(whole) if one else float(number) * (1e-3 if milli else 1.0)
