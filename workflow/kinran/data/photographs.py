"""Photographs of a set: the file of each light, and its linear light."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinran.base.encoding import Encoding, to_srgb
from kinran.base.files import InputError
from kinran.data.colour_profile import is_srgb, to_linear
from kinran.data.file_statements import statements
from kinran.data.light import LpLight
from kinran.data.picture_file import read_picture, size_of
from kinran.data.picture_kind import is_raw, kind_of
from kinran.data.radiance import SATURATED, Image, Radiance
from kinran.data.raw import raw_orientation, raw_size

MASK = re.compile(r"(.*[.])?mask", re.IGNORECASE)
"""Pattern of the stem of a mask's name: ``mask.png`` (DiLiGenT, LUCES), ``buddha.mask.tga``."""
CLIPPED = 254 / 255
"""Encoded value from which a sample is saturated: the last code but one, since white in a JPEG may miss the last."""
STRIP = 64
"""Rows that are decoded at a time, so that a large photograph takes the memory of its light alone. A choice."""


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

    It lies in the folder, or in one that the `.lp` names, from the folder or from the `.lp`. Where the images of a dome
    have other names than those in its `.lp`, and the folder has one for each light, they go by their order.

    Raises
    ------
    InputError
        The folder or an image is missing, or a light has images of several kinds.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    found: dict[str, Path] = {}
    missing: list[LpLight] = []
    listed: dict[Path, dict[str, list[Path]]] = {}
    for light in lights:
        places = [folder, folder / light.folder]
        if light.base:  # a project's images may lie beside the folder of its .lp
            places += [light.base / light.folder, light.base, light.base.parent / light.folder]
        alike: list[Path] = []
        for place in places:
            alike = listed.setdefault(place, _images(place)).get(light.name.casefold(), [])
            if alike:
                break
        paths = [path for path in alike if path.stem == light.name] or alike
        exact = [path for path in paths if path.name == light.file]
        if len(exact or paths) > 1:
            raise InputError(f"{paths[0]}: stands beside {paths[1].name}; keep one image for each light")
        if paths:
            found[light.name] = (exact or paths)[0]
        else:
            missing.append(light)
    if missing and not found and (ordered := in_order(folder, len(lights))):
        return {light.name: path for light, path in zip(lights, ordered, strict=True)}
    if missing:
        raise InputError(_says_missing(folder, missing[0], len(found), len(lights)))
    return found


def in_order(folder: Path, count: int) -> list[Path]:
    """Return the pictures of a folder by name, numbers by their value; none where it has not so many."""
    images = sorted(
        (path for name, paths in _images(folder).items() if not MASK.fullmatch(name) for path in paths), key=_natural
    )
    return images if len(images) == count else []


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return what sorts ``IMG_2`` before ``IMG_10``."""
    parts = re.split(r"(\d+)", path.name.casefold())
    return [(int(part), "") if k % 2 else (0, part) for k, part in enumerate(parts)]


def _says_missing(folder: Path, light: LpLight, found: int, count: int) -> str:
    says = f"{folder / (light.file or light.name)}: no such image, but the .lp names it"
    if found:
        return says
    images = sum(map(len, _images(folder).values()))
    return f"{says}; with as many pictures as lights, {count} and not {images}, they would go by their order"


def _images(folder: Path) -> dict[str, list[Path]]:
    """Return the images of a folder by their case-folded stems; none where there is no folder."""
    by_stem: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else []:
        if is_picture(path):
            by_stem.setdefault(path.stem.casefold(), []).append(path)
    return by_stem


def is_picture(path: Path) -> bool:
    """Return whether a file is a picture of any kind; what macOS keeps beside one (``._NAME``) is none."""
    return not path.name.startswith(".") and bool(kind_of(path)) and path.is_file()


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
    names = {light.name for light in lights}
    named: dict[str, list[Path]] = {}
    for path in sorted(folder.iterdir()):
        if not is_picture(path) or path.stem in names:
            continue
        parts = path.stem.split("_")
        owners = [name for k in range(1, len(parts)) if (name := "_".join(parts[:k])) in names]
        if owners:
            named.setdefault(owners[-1], []).append(path)
    inside = {name: [path for path in sorted((folder / name).glob("*")) if is_picture(path)] for name in names}
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
    return raw_size(path) if is_raw(path) else size_of(path)


def orientation(path: Path) -> int:
    """Return how a photograph is shown, as in EXIF, from its header.

    Raises
    ------
    InputError
        A RAW file cannot be read.
    """
    return raw_orientation(path) if is_raw(path) else statements(path).orientation


def read(path: Path, encoding: Encoding, crop: Crop | None = None) -> Radiance:
    """Read a photograph as linear light (y, x, 3), row 0 at the bottom, in units of the encoding's white.

    The crop is in the photograph as it is shown. Values in floating point (EXR, TIFF) are taken as they are, without
    flags. Where a photograph embeds or names a profile other than sRGB, its codes become those of sRGB first.

    Raises
    ------
    InputError
        The file is missing, truncated or of another kind, or the crop is not inside it.
    """
    picture = read_picture(path)
    values = picture.values
    if crop is not None:
        if crop.x + crop.width > values.shape[1] or crop.y + crop.height > values.shape[0]:
            raise InputError(
                f"{path}: is {values.shape[1]}x{values.shape[0]}, too small for the crop {crop}; choose a smaller one"
            )
        values = values[crop.y : crop.y + crop.height, crop.x : crop.x + crop.width]
    values = values[::-1]
    if picture.ceiling == 0:
        return Radiance.unflagged(np.ascontiguousarray(values, np.float32))
    light, flags = np.empty(values.shape, np.float32), np.empty(values.shape, np.uint8)
    for first in range(0, len(values), STRIP):
        rows = slice(first, first + STRIP)
        codes = values[rows].astype(np.float32) / np.float32(picture.ceiling)
        flags[rows] = (codes >= CLIPPED) * np.uint8(SATURATED)
        light[rows] = _light(codes, encoding, picture.profile)
    return Radiance(light, flags)


def _light(codes: Image, encoding: Encoding, profile: bytes) -> Image:
    """Return the linear light (y, x, 3) of codes, 1 for white."""
    if not profile or is_srgb(profile):
        return encoding.decode(codes)
    light = to_linear(codes, profile)
    return light if encoding.name == "srgb" else encoding.decode(to_srgb(np.maximum(light, 0)))
