"""Show the lights of a set of photographs: a table, and with --draw a picture of the dome from above.

With --out they are written to a new `.lp`, without those of --drop, and with the edits: `--mirror y` where y points
down, `--scale 10` where positions are in centimetres. The file that they come from stays as it is.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from kinran.base.drawing.canvas import FAINT, INK, Canvas, write
from kinran.base.drawing.hemisphere import SIDE, at, draw_hemisphere
from kinran.base.files import InputError
from kinran.base.frames import angles
from kinran.data.light import LpLight, directions
from kinran.data.light_files import find_lights, write_lp

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    folder: Annotated[Path, "FOLDER", "photographs, with the file of their lights"]
    lp: Annotated[Path | None, "--lp FILE", "lights, where they do not lie beside the photographs"] = None


@dataclass(frozen=True)
class Outputs:
    out: Annotated[Path | None, "--out FILE.lp", "lights to write; without it, they are only shown"] = None
    draw: Annotated[Path | None, "--draw FILE", "picture of the dome to write (.svg or .png)"] = None


@dataclass(frozen=True)
class Options:
    drop: Annotated[tuple[str, ...], "--drop NAME", "images whose lights are left out"] = ()
    mirror: Annotated[
        tuple[Literal["x", "y", "z"], ...],
        "--mirror AXIS",
        "axes whose sign is turned; +x is right, +y up, +z to the camera",
    ] = ()
    scale: Annotated[float, "factor of all lengths"] = 1.0


def main(inputs: Inputs, out: Outputs = Outputs(), options: Options = Options()) -> None:
    """Print the table, and write what is asked for."""
    if out.draw and out.draw.suffix not in (".svg", ".png"):
        raise InputError(f"{out.draw}: is neither .svg nor .png; give one of them")
    if not options.scale > 0:
        raise InputError(f"--scale {options.scale:g}: give a factor over 0")
    x, y, z = (-1.0 if axis in options.mirror else 1.0 for axis in ("x", "y", "z"))
    found = find_lights(inputs.folder, inputs.lp, (x, y, z))
    for remark in found.remarks:
        log.warning(remark)
    lights = [replace(light, length=options.scale * light.length) for light in kept(found.lights, options.drop)]
    print(table(lights))
    if out.draw:
        write(out.draw, dome(lights))
    if out.out:
        if any(light.intensity for light in lights):
            log.warning("%s: has no place for the intensities of the lamps; they are not written", out.out)
        write_lp(out.out, lights)
        log.info("%s: %d of %d lights", out.out, len(lights), len(found.lights))


def kept(lights: Sequence[LpLight], drop: Sequence[str]) -> list[LpLight]:
    """Return the lights whose image has none of these names, with or without suffix, in any case.

    Raises
    ------
    InputError
        A name is that of no light, or none is left.
    """
    names = {name.casefold() for name in drop}
    left = [light for light in lights if not names & _names(light)]
    for name in drop:
        if not any(name.casefold() in _names(light) for light in lights):
            raise InputError(f"--drop {name}: no light has that image; the first is {lights[0].file}")
    if not left:
        raise InputError("--drop: leaves no light; drop fewer")
    return left


def _names(light: LpLight) -> set[str]:
    return {light.name.casefold(), light.file.casefold()}


def next_light(lights: Sequence[LpLight]) -> NDArray[np.float64]:
    """Return the angle (n,) in degrees from each light to the one next to it; 0 for a light alone."""
    vectors = directions(lights)
    cosine = np.clip(vectors @ vectors.T, -1, 1)
    np.fill_diagonal(cosine, -1 if len(lights) > 1 else 1)
    return np.asarray(np.degrees(np.arccos(cosine.max(1))))


def table(lights: Sequence[LpLight]) -> str:
    """Return a line for each light: its image, x, y, z, elevation, azimuth, and the angle to the next light."""
    theta, phi = (np.degrees(angle) for angle in angles(directions(lights)))
    rows = [["image", "x", "y", "z", "elevation", "azimuth", "next light"]]
    for light, t, p, near in zip(lights, theta, phi, next_light(lights), strict=True):
        vector = [f"{light.length * part:.4f}" for part in light.direction]
        rows.append([light.file or light.name, *vector, f"{90 - t:.1f}°", f"{p:.1f}°", f"{near:.1f}°"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        )
        for row in rows
    ]
    return "\n".join(lines)


def dome(lights: Sequence[LpLight]) -> Canvas:
    """Return a drawing of the lights from above, with their names."""
    canvas = Canvas(SIDE, SIDE)
    draw_hemisphere(canvas)
    for light, theta, phi in zip(lights, *(np.degrees(a) for a in angles(directions(lights))), strict=True):
        point = at(float(theta), float(phi))
        canvas.dot(point, INK, 3.5, f"{light.file or light.name}: elevation {90 - theta:.1f}°, azimuth {phi:.1f}°")
        canvas.text((point[0] + 6, point[1] + 4), light.name, colour=FAINT, size=10)
    return canvas
