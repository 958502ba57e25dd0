"""A set of photographs with known lights, checked before anything is written."""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from kinran.base import encoding
from kinran.base.distances import Distances, check_lengths
from kinran.base.files import InputError
from kinran.base.log import progress
from kinran.data import photographs
from kinran.data.colour_profile import is_srgb, name_of
from kinran.data.hold_out_rule import held_out
from kinran.data.light import LpLight
from kinran.data.light_files import find_lights
from kinran.data.light_list import LightFile
from kinran.data.mask import find_mask, read_mask
from kinran.data.nominal_time import check_alike, exposure_of, nominal_seconds
from kinran.data.picture_file import check_whole, read_picture
from kinran.data.picture_kind import is_raw, kind_of

UNIT = 0.02
"""Difference of a vector's length from 1 above which it may be a position: a direction that is rounded to two decimals
differs by 0.009 at most."""


@dataclass(frozen=True)
class Known:
    """Encoding, crop, distances and file of lights that a user states for a set of photographs."""

    encoding: Annotated[
        str,
        "srgb (default), linear or gamma:EXPONENT; believed, and doubted in the log of ingest where values contradict",
    ] = "srgb"
    crop: Annotated[str, "--crop X,Y,W,H", "part to use, from the top left"] = ""
    lamp_mm: Annotated[
        float | None,
        "--lamp-mm MM",
        "length of 1 in the .lp: the dome's radius, or 1 where it holds positions in mm; without it, directions",
    ] = None
    field_mm: Annotated[float | None, "--field-mm MM", "width of a whole photograph on the fabric"] = None
    camera_mm: Annotated[
        float | None,
        "--camera-mm MM",
        "from the fabric to the lens; without it, seen along the normal everywhere",
    ] = None
    lp: Annotated[
        Path | None,
        "--lp FILE",
        "lights, where no .lp lies beside the photographs; +x is right, +y up, +z to the camera: one axis turned is"
        " seen by the relief, two (hollow in place of raised), a quarter turn and flat fabrics are not",
    ] = None

    mask: Annotated[
        Path | None,
        "--mask FILE",
        "picture that is white where the fabric is (default: mask.png beside the photographs, if there is one)",
    ] = None

    max_mp: Annotated[
        float | None,
        "--max-mp N",
        "most megapixels of the material: larger photographs are averaged in linear light, by a whole number of pixels",
    ] = None

    @property
    def distances(self) -> Distances:
        """Distances of lamps and camera.

        Raises
        ------
        InputError
            A distance is not over 0, or the field's width is missing, without which the others have no scale.
        """
        given = Distances(self.lamp_mm, self.field_mm, self.camera_mm)
        check_lengths(given)
        if given.field_mm is None and (given.lamp_mm or given.camera_mm):
            name = "lamp" if given.lamp_mm else "camera"
            raise InputError(f"--{name}-mm: needs the width of a photograph; give --field-mm as well")
        return given


@dataclass(frozen=True)
class PhotographSet:
    """A set of photographs that has been checked.

    Attributes
    ----------
    lights
        Lights of the `.lp`, relative to the middle of a whole photograph.
    size
        Width and height of a whole photograph in pixels.
    exposures_s
        Nominal exposure times of the brackets in seconds, longest first; 1 for single photographs.
    remarks
        Sentences on what was taken in a way that no file states.
    mask
        Picture that is white where the fabric is; None without one.
    frames
        The photograph or the bracket of each light, by its name.
    """

    lights: list[LpLight]
    size: tuple[int, int] = (1, 1)
    exposures_s: tuple[float, ...] = (1.0,)
    remarks: tuple[str, ...] = ()
    mask: Path | None = None
    frames: dict[str, list[Path]] = field(default_factory=dict)


def averaged(part: photographs.Crop | None, size: tuple[int, int], max_mp: float | None) -> int:
    """Return how many pixels along a side become one texel, so that no more than so many megapixels are left.

    Raises
    ------
    InputError
        The number of megapixels is not positive, or less than a texel.
    """
    if max_mp is None:
        return 1
    if not max_mp > 0:
        raise InputError(f"--max-mp {max_mp:g}: is no number of megapixels; give one such as 6")
    width, height = (part.width, part.height) if part else size
    pixels = max(1, math.ceil(math.sqrt(width * height * 1e-6 / max_mp) - 1e-9))
    if pixels > min(width, height):
        raise InputError(f"--max-mp {max_mp:g}: leaves no texel of {width}x{height} pixels; give more")
    return pixels


def inspect(folder: Path, known: Known, holdout: int) -> PhotographSet:
    """Check a whole set before anything is written: its lights, files, sizes and crop, and that each image decodes.

    Parameters
    ----------
    folder
        Folder of the photographs.
    known
        Encoding, crop and distances of the set.
    holdout
        One light of so many is held out; 0 for none.

    Raises
    ------
    InputError
        Something is wrong; the message names the first fault.
    """
    listed = find_lights(folder, known.lp)
    lights = listed.lights
    encoding.parse(known.encoding)
    crop = photographs.parse_crop(known.crop)
    held_out([None] * len(lights), holdout, folder)
    found = photographs.find_frames(folder, lights)
    remarks = listed.remarks + _by_order(folder, listed, found)
    seconds = exposures(found)
    first, paths = found[lights[0].name][0], [path for frames in found.values() for path in frames]
    check_orientation(paths)
    sizes = {path: photographs.size(path) for path in paths}
    for path, size in sizes.items():
        if size != sizes[first]:
            raise InputError(
                f"{path}: is {size[0]}x{size[1]} but {first.name} is {sizes[first][0]}x{sizes[first][1]};"
                " all photographs of a set have one size"
            )
    if crop and (crop.x + crop.width > sizes[first][0] or crop.y + crop.height > sizes[first][1]):
        width, height = sizes[first]
        raise InputError(f"{first}: is {width}x{height}, too small for the crop {crop}; choose a smaller one")
    settings = {}
    for path in progress(paths, "check", "photographs"):
        settings[path] = exposure_of(path)
        if not is_raw(path):  # LibRaw has looked into those
            check_whole(path)
    check_alike(settings, len(paths) == len(found))
    check_profile(first, known.encoding)
    mask = known.mask or find_mask(folder)
    if mask:
        inside = read_mask(mask, sizes[first], crop)
        remarks.append(f"{mask}: is taken as the mask; {1 - inside.mean():.1%} of the texels are outside and left out")
    return PhotographSet(lights, sizes[first], seconds, tuple(remarks), mask, found)


def _by_order(folder: Path, listed: LightFile, found: dict[str, list[Path]]) -> list[str]:
    """Return a remark where the photographs have other names than the lights."""
    light, path = listed.lights[0], found[listed.lights[0].name][0]
    if len(found[light.name]) > 1 or path.stem.casefold() == light.name.casefold():
        return []
    return [
        f"{listed.path}: names none of the {len(found)} photographs of {folder}; they go by their order, from"
        f" {path.name} for {light.name} on"
    ]


def check_orientation(paths: list[Path]) -> None:
    """Check that all photographs of a set are shown in one orientation: the lights are in the picture as it is shown.

    Raises
    ------
    InputError
        Two photographs differ.
    """
    first = photographs.orientation(paths[0])
    for path in paths[1:]:
        turned = photographs.orientation(path)
        if turned != first:
            raise InputError(
                f"{path}: is shown in orientation {turned} of EXIF but {paths[0].name} in {first}; a camera that looks"
                " down guesses it, so give all photographs the one in which their lights are stated"
            )


def check_profile(path: Path, encoded: str) -> None:
    """Check that no profile in a photograph contradicts the encoding that a user states.

    Raises
    ------
    InputError
        It embeds one that is not sRGB, and the encoding is another than srgb, which stands for what files say.
    """
    if encoded == "srgb" or is_raw(path) or kind_of(path) == "EXR":
        return
    profile = read_picture(path).profile
    if profile and not is_srgb(profile):
        raise InputError(
            f"--encoding {encoded}: but {path} embeds the colour profile '{name_of(profile)}'; leave the option out to"
            " go by the profile, or take the profile out"
        )


def remark_on_lengths(lights: list[LpLight], lamp_mm: float | None) -> str:
    """Return a warning where the vectors look like positions but are taken for directions; else an empty text."""
    lengths = [light.length for light in lights]
    if lamp_mm or max(abs(length - 1) for length in lengths) < UNIT:
        return ""
    return (
        f"the .lp's vectors are {min(lengths):.4g} to {max(lengths):.4g} long and taken for directions; if they are"
        " positions, give --lamp-mm (millimetres of a length of 1) and --field-mm"
    )


def exposures(found: dict[str, list[Path]]) -> tuple[float, ...]:
    """Return the nominal exposure times in seconds of a set's brackets, longest first; 1 for single photographs.

    Raises
    ------
    InputError
        Brackets and single images are mixed, or an exposure time is unknown or stands twice in a bracket.
    """
    times: set[float] = set()
    for name, frames in found.items():
        if (len(frames) > 1) != (len(next(iter(found.values()))) > 1):
            raise InputError(f"{frames[0]}: light '{name}' has {len(frames)} image(s), the first one more or fewer")
        own = frame_seconds(frames)
        if len(set(own)) < len(own):
            raise InputError(f"{frames[0]}: the bracket of light '{name}' has an exposure time twice; keep one of them")
        times |= set(own)
    return tuple(sorted(times, reverse=True))


def frame_seconds(frames: list[Path]) -> list[float]:
    """Return the nominal exposure time in seconds of a light's frames, from EXIF or name; 1 for a photograph alone.

    Raises
    ------
    InputError
        A frame of a bracket has no exposure time.
    """
    if len(frames) == 1 and not is_raw(frames[0]):
        return [1.0]
    seconds = [round(nominal_seconds(path), 9) for path in frames]
    for path, value in zip(frames, seconds, strict=True):
        if not value:
            raise InputError(f"{path}: has no exposure time in its EXIF; rename it to {path.stem}_1-250s{path.suffix}")
    return seconds
