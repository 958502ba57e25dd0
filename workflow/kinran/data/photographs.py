"""Photographs on disk, as linear light: JPEG, PNG, TIFF of 8 or 16 bit, EXR."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image as Pillow

from kinran.base.encoding import Encoding
from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.data.lights import LpLight
from kinran.data.radiance import SATURATED, Radiance
from kinran.data.raw import RAW, is_raw, raw_size

SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".exr")
"""Suffixes of photographs."""
CLIPPED = 254 / 255
"""Encoded value from which a sample is saturated: the last code but one, since white in a JPEG may miss the last."""

Pillow.MAX_IMAGE_PIXELS = None  # sizes are checked against the header before memory is taken


@dataclass(frozen=True)
class Crop:
    """Part of a picture, in pixels from its top left corner."""

    x: int
    y: int
    width: int
    height: int

    def __str__(self) -> str:
        return f"{self.x},{self.y},{self.width},{self.height}"


def parse_crop(text: str) -> Crop | None:
    """Parse a crop ``X,Y,W,H``; return None for an empty text.

    Raises
    ------
    InputError
        The text is not four whole numbers, or they are out of range.
    """
    if not text:
        return None
    try:
        x, y, width, height = (int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"crop '{text}': give X,Y,W,H in whole pixels from the top left") from None
    if x < 0 or y < 0 or width < 1 or height < 1:
        raise InputError(f"crop '{text}': X and Y start at 0, W and H at 1")
    return Crop(x, y, width, height)


def find(folder: Path, lights: list[LpLight]) -> dict[str, Path]:
    """Find the image of each light, by the light's name; suffix and case may differ from those in the `.lp`.

    It lies in the folder, or in a folder beside the `.lp` that the `.lp` names.

    Raises
    ------
    InputError
        The folder or an image is missing, or a light has images of several kinds.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    images = {name: _images(folder / name) for name in {"", *(light.folder for light in lights)}}
    found = {}
    for light in lights:
        by_stem = images[""]
        if light.name.casefold() not in by_stem:
            by_stem = images[light.folder]
        alike = by_stem.get(light.name.casefold(), [])
        paths = [path for path in alike if path.stem == light.name] or alike
        exact = [path for path in paths if path.name == light.file]
        if len(exact or paths) > 1:
            raise InputError(f"{paths[0]}: stands beside {paths[1].name}; keep one image for each light")
        if not paths:
            raise InputError(f"{folder / (light.file or light.name)}: no such image, but the .lp names it")
        found[light.name] = (exact or paths)[0]
    return found


def _images(folder: Path) -> dict[str, list[Path]]:
    """Return the images of a folder by their case-folded stems; none where there is no folder."""
    by_stem: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if path.suffix.lower() in SUFFIXES:
            by_stem.setdefault(path.stem.casefold(), []).append(path)
    return by_stem


def find_frames(folder: Path, lights: list[LpLight]) -> dict[str, list[Path]]:
    """Find the frames of each light, by the light's name: its only image, or its bracket.

    A bracket is all images in a folder of the light's name, or those that are named after it: ``NAME_25ms.tif``,
    ``NAME_1-250s.png``, ``NAME_1.cr2``.

    Raises
    ------
    InputError
        The folder or an image is missing, or a light has images of several kinds, or an image and a bracket.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    kinds = {*SUFFIXES, *RAW}
    names = {light.name for light in lights}
    named: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() not in kinds or path.stem in names:
            continue
        parts = path.stem.split("_")
        owners = [name for k in range(1, len(parts)) if (name := "_".join(parts[:k])) in names]
        if owners:
            named.setdefault(owners[-1], []).append(path)
    inside = {name: [p for p in sorted((folder / name).glob("*")) if p.suffix.lower() in kinds] for name in names}
    single = [light for light in lights if not inside[light.name] and light.name not in named]
    frames = {name: [path] for name, path in find(folder, single).items()}
    for light in lights:
        if inside[light.name] and light.name in named:
            raise InputError(
                f"{folder / light.name}: stands beside {named[light.name][0].name}; keep one of both brackets"
            )
        frames.setdefault(light.name, inside[light.name] or named.get(light.name, []))
    return frames


def size(path: Path) -> tuple[int, int]:
    """Return width and height in pixels (of RAW files: superpixels), from the header alone where there is one.

    Raises
    ------
    InputError
        The file cannot be read as an image.
    """
    if is_raw(path):
        return raw_size(path)
    try:
        if path.suffix.lower() == ".exr":
            plane = next(iter(read_exr(path).values()))
            return plane.shape[1], plane.shape[0]
        if path.suffix.lower() in (".tif", ".tiff"):
            with tifffile.TiffFile(path) as file:
                page = file.pages[0]
                return int(page.imagewidth), int(page.imagelength)
        with Pillow.open(path) as image:
            return image.size
    except (OSError, ValueError, tifffile.TiffFileError, SyntaxError) as error:
        raise InputError(f"{path}: is not an image that can be read ({error}); replace it") from None


def read(path: Path, encoding: Encoding, crop: Crop | None = None) -> Radiance:
    """Read a photograph as linear light (y, x, 3), row 0 at the bottom, in units of the encoding's white.

    Values in floating point (EXR, TIFF) are taken as they are, without flags.

    Raises
    ------
    InputError
        The file is missing, truncated or of another kind, or the crop is not inside it.
    """
    values, ceiling = _values(path)
    if crop is not None:
        if crop.x + crop.width > values.shape[1] or crop.y + crop.height > values.shape[0]:
            raise InputError(
                f"{path}: is {values.shape[1]}x{values.shape[0]}, too small for the crop {crop}; choose a smaller one"
            )
        values = values[crop.y : crop.y + crop.height, crop.x : crop.x + crop.width]
    values = values[::-1]
    if ceiling == 0:
        return Radiance.unflagged(np.ascontiguousarray(values, np.float32))
    scaled = values.astype(np.float32) / np.float32(ceiling)
    return Radiance(encoding.decode(scaled), (scaled >= CLIPPED) * np.uint8(SATURATED))


def _values(path: Path) -> tuple[NDArray[np.generic], int]:
    """Read the values (y, x, 3), top row first, and the value of white (0 for floating point)."""
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            if path.suffix.lower() == ".exr":
                channels = read_exr(path)
                missing = [name for name in "RGB" if name not in channels]
                if missing:
                    raise InputError(f"{path}: has no channel {missing[0]}; give an RGB picture")
                return np.stack([channels[name] for name in "RGB"], -1), 0
            if path.suffix.lower() in (".tif", ".tiff"):
                values = np.asarray(tifffile.imread(path))
            elif path.suffix.lower() == ".png":  # Pillow reduces 16-bit colour to 8 bit silently
                values = np.asarray(imagecodecs.png_decode(path.read_bytes()))
            else:
                with Pillow.open(path) as image:
                    mode = "RGB" if image.mode in ("P", "RGBA", "CMYK", "YCbCr", "LA", "L", "1") else None
                    values = np.asarray(image.convert(mode) if mode else image)
    except InputError:
        raise
    except Exception as error:  # decoders raise errors of any kind on a broken file
        raise InputError(f"{path}: is truncated or broken ({error}); replace it") from None
    if values.ndim == 2 or values.shape[2] == 2:  # grey, and grey with alpha
        values = values.reshape(*values.shape[:2], -1)[..., :1].repeat(3, -1)
    if values.ndim != 3 or values.shape[2] < 3:
        raise InputError(f"{path}: has the shape {values.shape}; give an RGB or grey picture")
    if values.dtype.kind == "f":
        return values[..., :3], 0
    if values.dtype not in (np.uint8, np.uint16, np.int32):
        raise InputError(f"{path}: has samples of type {values.dtype}; give 8 or 16 bit, or floating point")
    return values[..., :3], 255 if values.dtype == np.uint8 else 65535
