"""Pictures as their files hold them: the R, G, B of any kind of file, with what it says of their colours."""

import io
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image as Pillow
from PIL import ImageCms

from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.data.file_statements import statements
from kinran.data.orientation import shown_size, upright
from kinran.data.picture_kind import READ, kind_of

Pillow.MAX_IMAGE_PIXELS = None  # sizes are checked against the header before memory is taken
ICC, REDUCED = 34675, 254
"""Tags of TIFF: InterColorProfile, and NewSubfileType, whose lowest bit marks a smaller picture of another page."""
TAIL = 1 << 16
"""Bytes at the end of a file in which its last mark is looked for: cameras append little to it."""
PHOTOMETRIC = {0: "white is zero", 1: "grey", 2: "RGB", 3: "palette", 5: "CMYK", 6: "YCbCr"}
"""PhotometricInterpretation of the TIFF files that are read (TIFF 6.0)."""


@dataclass(frozen=True)
class Picture:
    """A picture as its file holds it.

    Attributes
    ----------
    values : (y, x, 3)
        R, G, B as the file's samples are, the top row first as the picture is shown.
    ceiling
        Value of white; 0 for floating point, which has none.
    profile
        The ICC profile of R, G, B that the file embeds or names; empty without one.
    """

    values: NDArray[np.generic]
    ceiling: int
    profile: bytes = b""


def size_of(path: Path) -> tuple[int, int]:
    """Return width and height of a picture that is no RAW file as it is shown, from its header.

    Raises
    ------
    InputError
        The file cannot be read as a picture.
    """
    kind = _known(path)
    orientation = statements(path).orientation
    try:
        if kind == "EXR":
            plane = next(iter(read_exr(path).values()))
            return plane.shape[1], plane.shape[0]
        if kind == "TIFF":
            with tifffile.TiffFile(path) as file:
                page = _main_page(file)
                return shown_size(int(page.imagewidth), int(page.imagelength), orientation)
        with Pillow.open(path) as image:
            return shown_size(*image.size, orientation)
    except InputError:
        raise
    except Exception as error:  # decoders raise errors of any kind on a broken file
        raise InputError(f"{path}: is not an image that can be read ({error}); replace it") from None


def read_picture(path: Path) -> Picture:
    """Read a picture that is no RAW file, as it is shown, with the profile that it embeds or names.

    Raises
    ------
    InputError
        The file is missing, truncated, of a kind that is not read, or its samples are no colours.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    said, stored = statements(path), _read_stored(path)
    values = upright(stored.values, said.orientation)
    return Picture(values, stored.ceiling, stored.profile or (said.profile if stored.ceiling else b""))


def _read_stored(path: Path) -> Picture:
    """Read a picture as its file stores it; errors as in `read_picture`."""
    kind = _known(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if kind == "EXR":
                return _exr(path)
            if kind == "TIFF":
                return _tiff(path)
            if kind == "PNG":  # Pillow reduces 16-bit colour to 8 bit silently
                values = np.asarray(imagecodecs.png_decode(path.read_bytes()))
                with Pillow.open(path) as image:
                    return _rgb(path, values, _profile(image.info.get("icc_profile")))
            if kind == "JPEG 2000":
                values = np.asarray(imagecodecs.jpeg2k_decode(path.read_bytes()))
                return _rgb(path, values, b"")
            with Pillow.open(path) as image:
                return _by_pillow(path, image)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is truncated or broken ({error}); replace it") from None


def check_whole(path: Path) -> None:
    """Check that a picture that is no RAW file is there as a whole, mostly from its beginning and its end alone.

    Raises
    ------
    InputError
        The file is cut off, or cannot be read as a picture.
    """
    kind, length = _known(path), path.stat().st_size
    with path.open("rb") as file:
        start = file.read(16)
        file.seek(max(length - TAIL, 0))
        end = file.read()
    whole = {
        "JPEG": b"\xff\xd9" in end,
        "PNG": b"IEND\xaeB`\x82" in end,
        "WebP": int.from_bytes(start[4:8], "little") + 8 <= length,
        "BMP": int.from_bytes(start[2:6], "little") <= length,
    }
    if kind == "TIFF":
        _check_strips(path, length)
    elif kind not in whole:
        read_picture(path)
    elif not whole[kind]:
        raise InputError(f"{path}: is truncated or broken (its end is missing); replace it")


def _check_strips(path: Path, length: int) -> None:
    try:
        with tifffile.TiffFile(path) as file:
            page = _main_page(file)
            last = max(at + count for at, count in zip(page.dataoffsets, page.databytecounts, strict=True))
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{path}: is truncated or broken ({error}); replace it") from None
    if last > length:
        raise InputError(f"{path}: is truncated or broken (it needs {last} bytes and has {length}); replace it")


def _known(path: Path) -> str:
    """Return the kind of a picture; raise `InputError` where it is one that is not read."""
    kind = kind_of(path)
    if kind not in READ:
        what = f"is a {kind} file, which is" if kind else "is of a kind that is"
        raise InputError(f"{path}: {what} not read; convert it to TIFF or PNG")
    return kind


def _exr(path: Path) -> Picture:
    channels = read_exr(path)
    missing = [name for name in "RGB" if name not in channels]
    if missing:
        raise InputError(f"{path}: has no channel {missing[0]}; give an RGB picture")
    return Picture(np.stack([channels[name] for name in "RGB"], -1), 0)


def _main_page(file: tifffile.TiffFile) -> Any:
    """Return the page that is the picture: the largest that is not marked as a smaller one of another.

    Raises
    ------
    InputError
        Several pages are as large.
    """
    pages = [page for first in file.pages for page in (first, *(first.pages or ()))]
    full = [page for page in pages if not int(page.tags[REDUCED].value if REDUCED in page.tags else 0) & 1] or pages
    page = max(full, key=lambda page: page.imagewidth * page.imagelength)
    alike = [other for other in full if other.shape[:2] == page.shape[:2]]
    if len(alike) > 1:
        raise InputError(f"{file.filehandle.path}: holds {len(alike)} pictures; save them as a file each")
    return page


def _tiff(path: Path) -> Picture:
    with tifffile.TiffFile(path) as file:
        page = _main_page(file)
        values, photometric, bits = page.asarray(), int(page.photometric), page.bitspersample
        if page.ndim == 3 and page.planarconfig == tifffile.PLANARCONFIG.SEPARATE:
            values = np.moveaxis(values, 0, -1)
        profile = page.tags[ICC].value if ICC in page.tags else b""
        colours = page.colormap if photometric == 3 else None
        jpeg = page.compression in (tifffile.COMPRESSION.JPEG, tifffile.COMPRESSION.OJPEG)
    if photometric not in PHOTOMETRIC or (photometric == 6 and not jpeg):
        name = getattr(tifffile.PHOTOMETRIC, "_value2member_map_", {}).get(photometric, photometric)
        raise InputError(f"{path}: holds {getattr(name, 'name', name)} colours, which are not read; save it as RGB")
    if colours is not None:
        return _rgb(path, np.moveaxis(colours, 0, -1)[values], _profile(profile))
    ceiling = 2**bits - 1 if values.dtype.kind == "u" and isinstance(bits, int) else None
    if photometric == 0:
        top = ceiling if ceiling is not None else np.iinfo(values.dtype).max
        values = (top - values).astype(values.dtype)
    if photometric == 5:
        return _of_inks(path, values, profile, ceiling or 255)
    return _rgb(path, values, _profile(profile), ceiling)


def _of_inks(path: Path, inks: NDArray[Any], profile: bytes, ceiling: int) -> Picture:
    """Return the R, G, B of inks, by their profile, or as (1 - C)(1 - K), which no profile of a press is."""
    if inks.ndim != 3 or inks.shape[2] < 4:
        raise InputError(f"{path}: has the shape {inks.shape}; save it as RGB")
    if profile:
        shown = imagecodecs.cms_transform(
            np.ascontiguousarray(inks[..., :4]), profile, imagecodecs.cms_profile("srgb"), colorspace="cmyk"
        )
        return _rgb(path, np.asarray(shown), b"", ceiling)
    light = 1 - inks[..., :4].astype(np.float32) / ceiling
    return Picture((light[..., :3] * light[..., 3:] * ceiling + 0.5).astype(inks.dtype), ceiling)


def _by_pillow(path: Path, image: Any) -> Picture:
    profile = image.info.get("icc_profile") or b""
    if image.mode == "CMYK":
        return _of_inks(path, np.asarray(image), profile, 255)
    if image.mode in ("P", "RGBA", "YCbCr", "LA", "L", "1", "PA"):
        image = image.convert("RGB")
    return _rgb(path, np.asarray(image), _profile(profile))


def _rgb(path: Path, values: NDArray[Any], profile: bytes, ceiling: int | None = None) -> Picture:
    """Return a picture of samples that are grey or R, G, B, with or without alpha.

    Raises
    ------
    InputError
        They are neither, or of a type that has no white.
    """
    if values.ndim == 2 or values.shape[2] == 2:  # grey, and grey with alpha
        values = values.reshape(*values.shape[:2], -1)[..., :1].repeat(3, -1)
    if values.ndim != 3 or values.shape[2] < 3:
        raise InputError(f"{path}: has the shape {values.shape}; give an RGB or grey picture")
    if values.dtype == np.bool_:
        values, ceiling = values.astype(np.uint8), 1
    if values.dtype.kind == "f":
        return Picture(values[..., :3], 0, profile)
    if values.dtype not in (np.uint8, np.uint16, np.int32):
        raise InputError(f"{path}: has samples of type {values.dtype}; give 8 or 16 bit, or floating point")
    return Picture(values[..., :3], ceiling or (255 if values.dtype == np.uint8 else 65535), profile)


def _profile(profile: bytes | None) -> bytes:
    """Return an ICC profile of R, G, B; empty for one of grey, or none."""
    if not profile:
        return b""
    try:
        return profile if ImageCms.ImageCmsProfile(io.BytesIO(profile)).profile.xcolor_space.strip() == "RGB" else b""
    except (OSError, ImageCms.PyCMSError):
        return b""
