"""A mirror sphere on the plane of the fabric, what it mirrors, and where that is."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.distances import Vector
from kinran.base.files import InputError
from kinran.capture.circles import Circle

Array = NDArray[np.float64]

LEAST_TURN = math.radians(3)
"""Least angle in radians between the rays of two spheres for a distance to follow: a highlight that is a pixel off on a
sphere of 50 pixels turns a ray by 2.3°, nearly as much."""


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


def _vector(values: Array) -> Vector:
    x, y, z = (float(value) for value in values)
    return x, y, z
