"""Find the positions of the lamps from the highlights on mirror spheres, and write them as a `.lp` file.

Spheres lie beside the fabric in every photograph. One gives directions; two, or one and the dome's radius, give
positions in millimetres from the middle of the photograph, for `kinran rti --lamp-mm 1`.
"""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinran.base.distances import Vector, unit
from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.base.log import progress
from kinran.data import photographs
from kinran.data.light_files import write_lp
from kinran.data.lights import LpLight
from kinran.data.picture_kind import is_raw

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Image = NDArray[np.float32]

RIM = 0.97
"""Share of a sphere's radius in which highlights are looked for: nearer to its rim it mirrors what lies behind it,
within 28° of the line of sight, and an outline 3 % too wide shows the background. No measurement stands behind it."""
LEAST_PEAK = 0.1
"""Least peak of a highlight, in units of white, over the median of all photographs: well over the noise of a photograph
and under any lamp that lights a fabric. No measurement stands behind it."""
LEAST_TURN = math.radians(3)
"""Least angle in radians between the rays of two spheres for a distance to follow: a highlight that is a pixel off on a
sphere of 50 pixels turns a ray by 2.3°, nearly as much."""


@dataclass(frozen=True)
class Circle:
    """Outline of a sphere in a photograph, in pixels from the top left."""

    x: float
    y: float
    radius: float

    def __str__(self) -> str:
        return f"{self.x:g},{self.y:g},{self.radius:g}"


@dataclass(frozen=True)
class Sphere:
    """A mirror sphere on the plane of the fabric, and the camera that sees it.

    Attributes
    ----------
    centre, radius
        Centre (3,) from the middle of the photograph (X to the right, Y up, Z to the camera) and radius, in
        millimetres, or in pixels where the field's width is unknown.
    camera
        Distance of the camera's centre of projection in millimetres; None where it is far away.
    """

    centre: Array
    radius: float
    camera: float | None


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
        "outline of a sphere in pixels from the top left; once for each sphere",
        parse_circle,
    ]
    field_mm: Annotated[float | None, "--field-mm MM", "width of a photograph on the fabric"] = None
    camera_mm: Annotated[float | None, "--camera-mm MM", "from the fabric to the lens"] = None
    lamp_mm: Annotated[float | None, "--lamp-mm MM", "distance of all lamps, as in a dome"] = None


def main(inputs: Inputs, out: Annotated[Path, "--out FILE.lp", "lights to write"], options: Options) -> None:
    """Write the `.lp`, and log how well the spheres agree."""
    circles, field_mm, lamp_mm = options.spheres, options.field_mm, options.lamp_mm
    if field_mm is None and (lamp_mm or options.camera_mm or len(circles) > 1):
        raise InputError("--field-mm: is missing; two spheres, --lamp-mm and --camera-mm need it")
    paths = sorted(path for path in inputs.folder.glob("*") if photographs.is_picture(path))
    paths = [path for path in paths if not is_raw(path)]
    if not paths:
        raise InputError(f"{inputs.folder}: has no photographs; give the folder of JPEG, PNG, TIFF or EXR files")
    size = photographs.size(paths[0])
    for circle in circles:
        far = max(abs(circle.x - size[0] / 2) - size[0] / 2, abs(circle.y - size[1] / 2) - size[1] / 2)
        if far + circle.radius + 1 > 0:
            raise InputError(f"sphere '{circle}': is not whole in the photographs of {size[0]}x{size[1]}; correct it")
    spheres = [place(circle, size, field_mm, options.camera_mm) for circle in circles]
    spots = [find_highlights(paths, circle) for circle in circles]
    lights, turns = [], []
    for k, path in enumerate(paths):
        rays = [mirror(s, *on_plane(*spot[k], size, field_mm)) for s, spot in zip(spheres, spots, strict=True)]
        where, turn = locate(rays, lamp_mm, path)
        if where[2] <= 0:
            raise InputError(f"{path}: its highlight is that of a lamp under the horizon; check the sphere's outline")
        length = math.hypot(*where)
        lights.append(LpLight(path.stem, unit(where), path.name, length=length))
        turns.append(math.degrees(turn))
    write_lp(out, lights)
    positions = lamp_mm or len(circles) > 1
    what = "positions in mm (kinran rti --lamp-mm 1 …)" if positions else "directions"
    agree = f"; the spheres agree to {np.median(turns):.2f}° (worst {max(turns):.2f}°)" if len(circles) > 1 else ""
    log.info("%s: %d lights, %s%s", out, len(lights), what, agree)


def on_plane(x: float, y: float, size: tuple[int, int], field_mm: float | None) -> tuple[float, float]:
    """Return (X, Y) of a photograph's point on the fabric's plane, in mm, or in pixels where `field_mm` is unknown."""
    pixel = (field_mm or size[0]) / size[0]
    return (x - size[0] / 2) * pixel, (size[1] / 2 - y) * pixel


def place(circle: Circle, size: tuple[int, int], field_mm: float | None, camera_mm: float | None) -> Sphere:
    """Return the sphere that touches the plane of the fabric and has this outline, which is that of a cone of rays."""
    x, y = on_plane(circle.x, circle.y, size, field_mm)
    radius = circle.radius * (field_mm or size[0]) / size[0]
    if camera_mm is None:
        return Sphere(np.array([x, y, radius]), radius, None)
    off = math.hypot(x, y)
    long = radius / math.sqrt(math.cos(math.atan(off / camera_mm)))  # seen askew, it is an ellipse of the same area
    near, far = math.atan((off - long) / camera_mm), math.atan((off + long) / camera_mm)
    axis, half = (near + far) / 2, (far - near) / 2
    radius = camera_mm / (1 + math.cos(axis) / math.sin(half))
    distance = radius / math.sin(half)
    side = distance * math.sin(axis) / max(off, 1e-12)
    return Sphere(np.array([side * x, side * y, camera_mm - distance * math.cos(axis)]), radius, camera_mm)


def mirror(sphere: Sphere, x: float, y: float) -> tuple[Array, Array]:
    """Return the point (3,) of a sphere seen at (X, Y) of the plane, and the direction (3,) that it mirrors."""
    start, ahead = np.array([x, y, 0.0]), np.array([0.0, 0.0, -1.0])
    if sphere.camera is not None:
        eye = np.array([0.0, 0.0, sphere.camera])
        ahead = (start - eye) / np.linalg.norm(start - eye)
    middle = start - sphere.centre
    along = middle @ ahead
    inside = max(along**2 - middle @ middle + sphere.radius**2, 0.0)
    point = start + (-along - math.sqrt(inside)) * ahead
    normal = (point - sphere.centre) / np.linalg.norm(point - sphere.centre)
    return point, ahead - 2 * (normal @ ahead) * normal


def locate(rays: Sequence[tuple[Array, Array]], lamp_mm: float | None, path: Path) -> tuple[Vector, float]:
    """Find the position of a lamp by least squares from the rays of the spheres.

    Parameters
    ----------
    rays
        Start (3,) and unit direction (3,) of the ray of each sphere.
    lamp_mm
        Distance of the lamp from the middle of the photograph, for one ray; None to return its direction.
    path
        Photograph, to name in an error.

    Returns
    -------
    where : (3,)
        Position of the lamp, or direction of one ray.
    angle : float
        Largest angle in radians between a ray and the way from its start to the lamp.

    Raises
    ------
    InputError
        The rays of several spheres do not meet before them, or the sphere lies beyond `lamp_mm`.
    """
    points, ahead = (np.array(part) for part in zip(*rays, strict=True))
    if len(rays) > 1:
        across = np.eye(3) - ahead[:, :, None] * ahead[:, None]
        where = np.linalg.solve(across.sum(0), (across @ points[..., None]).sum(0))[:, 0]
        turn = max(math.acos(min(1.0, float(a @ b))) for a in ahead for b in ahead)
        if turn < LEAST_TURN or ((where - points) * ahead).sum(1).min() <= 0:
            raise InputError(
                f"{path}: the highlights do not say how far the lamp is (their rays turn by {math.degrees(turn):.1f}°);"
                " put the spheres further apart, or give one and --lamp-mm"
            )
    elif lamp_mm:  # where the ray leaves a ball of that radius around the middle of the photograph
        along = float(points[0] @ ahead[0])
        inside = along**2 - float(points[0] @ points[0]) + lamp_mm**2
        if inside <= 0:
            raise InputError(
                f"{path}: the sphere is further from the middle than the lamps, {lamp_mm:g} mm; check both"
            )
        where = points[0] + (math.sqrt(inside) - along) * ahead[0]
    else:
        return _vector(ahead[0]), 0.0
    towards = (where - points) / np.linalg.norm(where - points, axis=1, keepdims=True)
    return _vector(where), max(math.acos(min(1.0, float(a @ b))) for a, b in zip(towards, ahead, strict=True))


def find_highlights(paths: Sequence[Path], circle: Circle) -> list[tuple[float, float]]:
    """Return the place (x, y) of the highlight on a sphere in each photograph, in pixels from the top left.

    Raises
    ------
    InputError
        The sphere is not in a photograph, or a photograph has no highlight on it.
    """
    left, top = math.floor(circle.x - circle.radius), math.floor(circle.y - circle.radius)
    side = math.ceil(2 * circle.radius) + 1
    crop = photographs.Crop(left, top, side, side)
    pictures: list[Image] = []
    for path in progress(paths, f"sphere {circle}", "photographs"):
        light = photographs.read(path, parse("linear"), crop).value
        pictures.append(light[::-1].mean(-1))
    usual = np.median(pictures, axis=0)
    spots = []
    for path, picture in zip(paths, pictures, strict=True):
        try:
            x, y = highlight(picture - usual, Circle(circle.x - left, circle.y - top, circle.radius))
        except ValueError:
            raise InputError(
                f"{path}: has no highlight on the sphere {circle}; check its outline, or take the photograph out"
            ) from None
        spots.append((x + left, y + top))
    return spots


def highlight(picture: NDArray[np.floating], circle: Circle) -> tuple[float, float]:
    """Return the centre (x, y) of the brightest spot of a picture (y, x) within a circle, down to half its peak.

    Raises
    ------
    ValueError
        No spot is brighter than `LEAST_PEAK`.
    """
    y, x = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    inside = np.hypot(x - circle.x, y - circle.y) < RIM * circle.radius
    bright = np.where(inside, picture, 0)
    peak = float(bright.max())
    if peak < LEAST_PEAK:
        raise ValueError("no highlight")
    spots, _ = ndimage.label(bright > peak / 2)
    weight = np.where(spots == spots[np.unravel_index(np.argmax(bright), bright.shape)], bright, 0)
    return float((weight * x).sum() / weight.sum()), float((weight * y).sum() / weight.sum())


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
