"""How a photograph was exposed: from its EXIF or, for the time, from its name."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image as Pillow

from kinran.base.files import InputError
from kinran.data.picture_kind import is_raw
from kinran.data.raw import raw_exposure

EXIF, TIME, ISO, APERTURE = 0x8769, 0x829A, 0x8827, 0x829D
"""Tags of EXIF: the directory of the exposure, and ExposureTime, PhotographicSensitivity and FNumber in it."""
ALIKE = 0.02
"""Largest relative difference of exposure settings that are alike: rounding in EXIF explains it."""
IN_NAME = re.compile(r"_(?:(1)-(\d+)|(\d+(?:\.\d+)?)(m?))s(?=_|$)")
"""Pattern of a time in a name: ``_1-250s``, ``_0.004s`` or ``_4ms``, at its end or before another ``_``."""


@dataclass(frozen=True)
class ExposureSettings:
    """How a photograph was exposed, as its EXIF says; 0 for what it does not say.

    Attributes
    ----------
    seconds, iso, aperture
        Nominal shutter time, ISO, and aperture (f-number).
    """

    seconds: float
    iso: float
    aperture: float


def nominal_seconds(path: Path) -> float:
    """Return the nominal exposure time in seconds from EXIF, or else from the file's name; 0 where neither has one."""
    return exif_seconds(path) or time_in_name(path.stem)


def exif_seconds(path: Path) -> float:
    """Return the nominal exposure time in seconds of a file's EXIF; 0 where it has none."""
    return exposure_of(path).seconds


def exposure_of(path: Path) -> ExposureSettings:
    """Return how a file's EXIF says that it was exposed, from its header; 0 for what it does not say.

    Raises
    ------
    InputError
        A RAW file cannot be read.
    """
    if is_raw(path):
        return ExposureSettings(*raw_exposure(path))
    try:
        with Pillow.open(path) as image:
            tags = image.getexif()
            inside = tags.get_ifd(EXIF)
            values = [_number(inside.get(tag, tags.get(tag, 0))) for tag in (TIME, ISO, APERTURE)]
    except (OSError, SyntaxError, ValueError, TypeError):
        return ExposureSettings(0.0, 0.0, 0.0)
    return ExposureSettings(*values)


def _number(value: Any) -> float:
    """Return a number of EXIF, the first where it has several; 0 for what is none."""
    try:
        return max(float(value[0] if isinstance(value, tuple) else value or 0), 0.0)
    except (TypeError, ValueError, ZeroDivisionError, IndexError):
        return 0.0


def time_in_name(stem: str) -> float:
    """Return the seconds in a name such as ``cloth_25ms``, ``cloth_0.004s_2`` or ``cloth_1-250s``; 0 without any."""
    found = IN_NAME.search(stem)
    if not found:
        return 0.0
    one, whole, number, milli = found.groups()
    return 1 / float(whole) if one else float(number) * (1e-3 if milli else 1.0)


def check_alike(settings: dict[Path, ExposureSettings], single: bool) -> None:
    """Check that all photographs of a set were exposed alike, as far as EXIF says; a bracket differs in time alone.

    Raises
    ------
    InputError
        Two photographs differ.
    """
    parts = {"iso": "ISO {:g}", "aperture": "f/{:g}", **({"seconds": "{:.4g} s"} if single else {})}
    for part, form in parts.items():
        stated = [(path, float(getattr(value, part))) for path, value in settings.items() if getattr(value, part)]
        for path, value in stated[1:]:
            first, other = stated[0]
            if abs(value / other - 1) > ALIKE:
                raise InputError(
                    f"{path}: was taken with {form.format(value)} but {first.name} with {form.format(other)};"
                    " all photographs of a set need one exposure"
                )
