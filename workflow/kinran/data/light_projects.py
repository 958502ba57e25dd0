"""Lights in files of other programs: projects, domes and viewers of RelightLab, and the lamps of LUCES."""

import json
import math
from pathlib import Path, PurePosixPath
from typing import Any

from kinran.base.distances import Vector
from kinran.base.files import InputError
from kinran.data.light_list import AS_THEY_ARE, LightFile, numbered, over_horizon, with_intensities

PROJECTS = (".relight", ".json", ".dome")
"""Suffixes of RelightLab's files (cnr-isti-vclab/relight, src/project.cpp and src/dome.cpp)."""
VECTORS = {"directional": "directions", "spherical": "positionsSphere", "lights3d": "positions3d"}
"""Vectors that RelightLab takes, by its ``lightConfiguration``."""
LED_PARAMETERS = "led_params.txt"
"""File of the lamps of a set of LUCES (dlichy/FastNFPSCode, datasets/io_nf.py)."""


def read_project(path: Path, signs: Vector = AS_THEY_ARE) -> LightFile:
    """Read the lights of a RelightLab project, of a dome, or of an ``info.json`` that relight's viewer reads.

    Without images in the file, lights go by the order of the photographs. A dome has directions, or positions in
    millimetres. Images that the project skips are left out.

    Raises
    ------
    InputError
        The file cannot be read, or has no lights, or another number of them than of images.
    """
    try:
        project = json.loads(path.read_text(encoding="utf-8-sig"))
        dome, images = project.get("dome", project), project.get("images", [])
        key = VECTORS[dome.get("lightConfiguration", "directional")]
        own = [_vector(image["direction"], "xyz") for image in images if "direction" in image]
        vectors = [_vector(entry, "xyz") for entry in dome.get(key, [])] or own or _of_viewer(project)
        gains = [_vector(entry, "rgb") for entry in dome.get("ledAdjust", [])]
        width = float(dome.get("imageWidth", 0))
        folder = str(project.get("folder", "")).replace("\\", "/")
        names = [str(PurePosixPath(folder, image["filename"])) for image in images] or numbered(len(vectors))
        used = [k for k in range(len(names)) if not images or not images[k].get("skip")]
    except (OSError, UnicodeDecodeError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{path}: is no project of RelightLab ({error!r}); give its .relight file, or a .lp") from None
    if not vectors:
        raise InputError(f"{path}: has no lights; find them in RelightLab, or with kinran highlights")
    if len(vectors) not in (len(names), len(used)):
        raise InputError(f"{path}: has {len(vectors)} lights for {len(names)} images; correct it in RelightLab")
    remarks = []
    if len(used) < len(names):
        remarks.append(f"{path}: skips {len(names) - len(used)} of its images, which are left out")
    if key != "directions":
        remarks.append(f"{path}: holds positions in mm; take them with --lamp-mm 1 --field-mm {width:g}")
    if len(vectors) == len(names):
        vectors = [vectors[k] for k in used]
    named = [(PurePosixPath(names[k]), vector) for k, vector in zip(used, vectors, strict=True)]
    for given, vector in named:
        if not math.hypot(*vector) > 0:
            raise InputError(f"{path}: has no light of {given.name}; find it in RelightLab, or skip the image there")
    found = over_horizon(path, named, remarks, signs)
    if len(gains) != len(names) or min(map(min, gains)) <= 0:
        return found
    return with_intensities(found, {PurePosixPath(names[k]).name: _inverse(gains[k]) for k in used})


def read_led_parameters(path: Path, signs: Vector = AS_THEY_ARE) -> LightFile:
    """Read the lamps of a set of LUCES: a header, the camera, then position, axis, light and exponent of each lamp.

    Positions there are in millimetres from the camera's centre, x to the right, y down, z ahead. Here they are from the
    point in the middle of the picture at the mean distance of the object. The light of a lamp is Φ cos^μ of the angle
    from its axis to that point.

    Raises
    ------
    InputError
        The file cannot be read, or is of another layout.
    """
    try:
        rows = [line.split() for line in path.read_text(encoding="utf-8-sig").splitlines() if line.strip()]
        count, high, wide, focal, x0, y0, distance = (float(word) for word in rows[1][:7])
        wide, high = (wide, high) if abs(wide - 2 * x0) < abs(high - 2 * x0) else (high, wide)
        pixel = distance / focal
        middle = ((wide / 2 - x0) * pixel, (high / 2 - y0) * pixel, distance)
        named, light = [], {}
        for k, row in enumerate(rows[2:], 1):
            x, y, z, *rest = (float(word) for word in row)
            axis, phi = rest[:3], rest[3:6] if len(rest) > 6 else [rest[3]] * 3
            exponent = rest[6] if len(rest) > 6 else rest[4]
            towards = [a - b for a, b in zip(middle, (x, y, z), strict=True)]
            cosine = sum(a * b for a, b in zip(towards, axis, strict=True)) / math.hypot(*towards) / math.hypot(*axis)
            off_axis = max(cosine, 0.0) ** exponent
            red, green, blue = (value * off_axis for value in phi)
            named.append((PurePosixPath(f"{k:02d}.png"), (-towards[0], towards[1], towards[2])))
            light[f"{k:02d}.png"] = (red, green, blue)
        if len(named) != count or min(map(min, light.values())) <= 0:
            raise ValueError(f"{len(named)} lamps, of which all should shine, and {count:g} images")
    except (OSError, UnicodeDecodeError, ValueError, IndexError, ZeroDivisionError) as error:
        raise InputError(f"{path}: is not as LUCES has it ({error}); give a .lp by --lp FILE") from None
    said = (
        f"{path}: holds positions in mm; take them with --lamp-mm 1 --field-mm {wide * pixel:.4g}"
        f" --camera-mm {distance:.4g}"
    )
    return with_intensities(over_horizon(path, named, [said], signs), light)


def _vector(entry: dict[str, Any], keys: str) -> Vector:
    first, second, third = (float(entry[key]) for key in keys)
    return first, second, third


def _of_viewer(info: dict[str, Any]) -> list[Vector]:
    """Return the lights in what a viewer of relight reads beside its pictures: numbers in a row, or three by three."""
    numbers: list[Any] = info.get("lights", [])
    flat = [part for entry in numbers for part in (entry if isinstance(entry, list) else [entry])]
    x, y, z = ([float(part) for part in flat[k::3]] for k in range(3))
    return list(zip(x, y, z, strict=True))


def _inverse(gain: Vector) -> Vector:
    """Return the light of a lamp whose photographs are multiplied by `gain` to even it out."""
    return 1 / gain[0], 1 / gain[1], 1 / gain[2]
