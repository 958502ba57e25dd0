"""Find the positions of the lamps from the highlights on mirror spheres, and write them as a `.lp` file.

Spheres lie beside the fabric in every photograph. One gives directions; two, or one and the dome's radius, give
positions in millimetres from the middle of the photograph, for `kinran rti --lamp-mm 1`. They are found in the
photographs, or given by --sphere. A photograph without a lamp's highlight is left out. The picture beside the `.lp`
shows each outline and each highlight: look at it.
"""

import logging
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from kinran.base.distances import unit
from kinran.base.files import InputError
from kinran.base.log import progress
from kinran.base.pictures import write_png
from kinran.capture.circles import Circle
from kinran.capture.find_spheres import find_spheres
from kinran.capture.highlights_drawing import Photograph, SeenSphere, drawing
from kinran.capture.lamp_spots import NoLampError, brightness, cut_out, lamp_spot
from kinran.capture.spheres import locate, mirror, on_plane, place
from kinran.data import photographs
from kinran.data.light import LpLight
from kinran.data.light_files import write_lp
from kinran.data.picture_kind import is_raw

log = logging.getLogger(__name__)

Size = tuple[int, int]

LEAST_LAMPS = 0.5
"""Least share of the photographs that must show a lamp: below, an outline that is wrong is likelier than so many
photographs without a lamp. A choice."""
ROOM = 1.15
"""Width of what the picture shows of a sphere, over its own, so that an outline that is wrong is seen. A choice."""


def parse_circle(text: str) -> Circle:
    """Parse a circle ``X,Y,RADIUS`` in pixels.

    Raises
    ------
    InputError
        The text is not three numbers, or the radius is too small.
    """
    try:
        x, y, radius = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"sphere '{text}': give X,Y,RADIUS in pixels from the top left") from None
    if not radius >= 8:
        raise InputError(f"sphere '{text}': is too small to say a direction; its radius must be 8 pixels or more")
    return Circle(x, y, radius)


@dataclass(frozen=True)
class Inputs:
    folder: Annotated[Path, "FOLDER", "photographs, one a light"]


@dataclass(frozen=True)
class Options:
    spheres: Annotated[
        tuple[Circle, ...],
        "--sphere X,Y,RADIUS",
        "outline of a sphere in pixels from the top left, once for each; without it, spheres are found",
        parse_circle,
    ] = ()
    field_mm: Annotated[float | None, "--field-mm MM", "width of a photograph on the fabric"] = None
    camera_mm: Annotated[float | None, "--camera-mm MM", "from the fabric to the lens"] = None
    lamp_mm: Annotated[float | None, "--lamp-mm MM", "distance of all lamps, as in a dome"] = None


def main(inputs: Inputs, out: Annotated[Path, "--out FILE.lp", "lights to write"], options: Options) -> None:
    """Write the `.lp` and the picture beside it, and log how well the spheres agree."""
    circles, field_mm, lamp_mm = options.spheres, options.field_mm, options.lamp_mm
    if field_mm is None and (lamp_mm or options.camera_mm or len(circles) > 1):
        raise InputError("--field-mm: is missing; two spheres, --lamp-mm and --camera-mm need it")
    paths, size = _photographs(inputs.folder)
    for circle in circles:
        far = max(abs(circle.x - size[0] / 2) - size[0] / 2, abs(circle.y - size[1] / 2) - size[1] / 2)
        if far + circle.radius + 1 > 0:
            raise InputError(f"sphere '{circle}': is not whole in the photographs of {size[0]}x{size[1]}; correct it")
    if not circles:
        found = find_spheres(paths)
        log.info("found %s", " ".join(f"--sphere {circle}" for circle in found))
        circles = tuple(found if field_mm else found[:1])
        if len(circles) < len(found):
            log.warning("only --sphere %s is used, the largest: without --field-mm, several say no more", circles[0])
    seen = find_highlights(paths, circles)
    lights, turns = [], []
    spheres = [place(circle, size, field_mm, options.camera_mm) for circle in circles]
    for k, (path, photograph) in enumerate(zip(paths, seen, strict=True)):
        if photograph.fault:
            continue
        at = [one.spot_in_photograph for one in photograph.spheres]
        rays = [mirror(sphere, *on_plane(*spot, size, field_mm)) for sphere, spot in zip(spheres, at, strict=True)]
        where, turn = locate(rays, lamp_mm, path)
        if where[2] <= 0:
            seen[k] = replace(photograph, fault="mirrors a lamp at or under the horizon")
            continue
        lights.append(LpLight(path.stem, unit(where), path.name, length=math.hypot(*where)))
        turns.append(math.degrees(turn))
    without = [(path, photograph.fault) for path, photograph in zip(paths, seen, strict=True) if photograph.fault]
    if len(lights) < LEAST_LAMPS * len(paths):
        path, fault = without[0]
        where_not = " ".join(map(str, circles))
        raise InputError(f"{path}: {fault} {where_not}, as {len(without)} of {len(paths)}; check its outline")
    for path, fault in without:
        log.warning("%s: %s; it is left out", path, fault)
    write_lp(out, lights)
    write_png(out.with_suffix(".png"), drawing(seen))
    positions = lamp_mm or len(circles) > 1
    what = "positions in mm (kinran rti --lamp-mm 1 …)" if positions else "directions"
    agree = f"; the spheres agree to {np.median(turns):.2f}° (worst {max(turns):.2f}°)" if len(circles) > 1 else ""
    log.info("%s: %d lights, %s%s; %s shows them", out, len(lights), what, agree, out.with_suffix(".png").name)


def _photographs(folder: Path) -> tuple[list[Path], Size]:
    """Return the photographs of a folder that have the size of most, and that size; others are left out.

    Raises
    ------
    InputError
        There are none.
    """
    paths = sorted(path for path in folder.glob("*") if photographs.is_picture(path) and not is_raw(path))
    if not paths:
        raise InputError(f"{folder}: has no photographs; give the folder of JPEG, PNG, TIFF or EXR files")
    sizes = [photographs.size(path) for path in paths]
    size = Counter(sizes).most_common(1)[0][0]
    for path, own in zip(paths, sizes, strict=True):
        if own != size:
            log.warning("%s: is %dx%d, not %dx%d as most; it is left out", path, *own, *size)
    return [path for path, own in zip(paths, sizes, strict=True) if own == size], size


def find_highlights(paths: Sequence[Path], circles: Sequence[Circle]) -> list[Photograph]:
    """Return what each photograph shows of the spheres: the place of the highlight on each, or what is wrong."""
    cut = []
    for path in progress(paths, "highlights", "photographs"):
        picture = brightness(path)
        cut.append([cut_out(picture, circle, ROOM) for circle in circles])
    usual = [np.median([parts[k][0] for parts in cut], axis=0) for k in range(len(circles))]
    found = []
    for path, parts in zip(paths, cut, strict=True):
        spheres, fault = [], ""
        for (picture, inside), median, circle in zip(parts, usual, circles, strict=True):
            spot = None
            try:
                spot = lamp_spot(picture, median, inside)
            except NoLampError as none:
                fault = fault or str(none)
            spheres.append(SeenSphere(picture, circle, inside, spot))
        found.append(Photograph(path.stem, spheres, fault))
    return found
