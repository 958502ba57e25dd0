"""The exposure time that a camera wrote into a file."""

from pathlib import Path

from PIL import Image as Pillow

from kinran.radiance.raw import is_raw

EXIF, TIME = 0x8769, 0x829A


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
