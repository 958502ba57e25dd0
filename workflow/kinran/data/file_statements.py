"""What a picture's file says beside its samples: how it is shown, and how it encodes light; from its header alone."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imagecodecs
import tifffile
from PIL import Image as Pillow

from kinran.data.colour_profile import REC709
from kinran.data.orientation import STEPS, UPRIGHT
from kinran.data.picture_kind import kind_of

ORIENTATION, EXIF, COLOUR_SPACE, INTEROPERABILITY, INDEX = 274, 0x8769, 0xA001, 0xA005, 1
"""Tags of EXIF 2.32: Orientation, the directory of the photograph, ColorSpace in it (1 for sRGB), the directory of
interoperability and its index (R03 for the option file of DCF, which is Adobe RGB)."""
SCREEN = 0.45455
"""Exponent in gAMA of a PNG for screens: many programs mean sRGB by it (PNG, third edition, 11.3.2.2)."""
NEAR = 0.01
"""Difference of two exponents up to which they are one: 1/2.2 and 1/2.15. A choice."""


@dataclass(frozen=True)
class Statements:
    """What a file says of its picture.

    Attributes
    ----------
    orientation
        How it is shown, as in EXIF.
    srgb
        Where it says that it is sRGB, such as ``EXIF``; empty where it does not.
    profile
        ICC profile of another encoding that it names without embedding one; empty for none.
    """

    orientation: int = UPRIGHT
    srgb: str = ""
    profile: bytes = b""


def statements(path: Path) -> Statements:
    """Return what a file says of its picture; nothing for RAW, EXR and files that cannot be read."""
    kind = kind_of(path)
    try:
        if kind == "PNG":
            return _of_png(path)
        if kind in ("JPEG", "WebP", "TIFF"):
            with Pillow.open(path) as image:
                return _of_exif(image.getexif())
    except (OSError, SyntaxError, ValueError, TypeError, KeyError, tifffile.TiffFileError):
        pass
    return Statements()


def _of_exif(exif: Any) -> Statements:
    photograph = exif.get_ifd(EXIF)
    index = exif.get_ifd(INTEROPERABILITY).get(INDEX) or photograph.get(INTEROPERABILITY, {})
    adobe = str(index).strip("\0 ").upper() == "R03" or photograph.get(COLOUR_SPACE) == 2
    orientation = exif.get(ORIENTATION, UPRIGHT)
    return Statements(
        orientation if orientation in STEPS else UPRIGHT,
        "EXIF" if photograph.get(COLOUR_SPACE) == 1 else "",
        imagecodecs.cms_profile("adobergb") if adobe else b"",
    )


def _of_png(path: Path) -> Statements:
    """Return what the chunks of a PNG say; sRGB stands over gAMA, and a profile over both (PNG, third edition, 4.3)."""
    chunks = png_chunks(path)
    exif = Pillow.Exif()
    if b"eXIf" in chunks:
        exif.load(b"Exif\0\0" + chunks[b"eXIf"])
    said = _of_exif(exif)
    if b"iCCP" in chunks:
        return Statements(said.orientation)
    if b"sRGB" in chunks:
        return Statements(said.orientation, "chunk sRGB")
    exponent = int.from_bytes(chunks.get(b"gAMA", b"")[:4]) / 100_000
    if not exponent:
        return said
    if abs(exponent - SCREEN) < NEAR:
        return Statements(said.orientation, "chunk gAMA")
    return Statements(said.orientation, "", imagecodecs.cms_profile("rgb", gamma=1 / exponent, **REC709))


def png_chunks(path: Path) -> dict[bytes, bytes]:
    """Return the small chunks of a PNG by their types: those before its pixels, and EXIF, wherever it is."""
    chunks: dict[bytes, bytes] = {}
    with path.open("rb") as file:
        file.seek(8)
        while len(head := file.read(8)) == 8:
            length, name = int.from_bytes(head[:4]), head[4:]
            if name in (b"sRGB", b"gAMA", b"iCCP", b"eXIf"):
                chunks[name] = file.read(length)
                file.seek(4, 1)
            else:
                file.seek(length + 4, 1)
    return chunks
