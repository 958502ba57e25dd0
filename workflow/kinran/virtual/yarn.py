"""The geometry of a woven repeat: twisted silk yarns, flat gold strips, floats of a pattern; lengths in millimetres.

X is the weft, Y the warp, Z points to the camera; the origin is the middle of the field on the fabric's
mean surface. The figure stands once in each repeat and has no symmetry, so that a mirrored or a rotated
picture shows.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter, gaussian_filter1d

Array = NDArray[np.float64]

REPEAT = 4.8
"""Width and height of the repeat. Like all numbers here it is made up, for silk with strips of gold leaf."""
MARGIN = 1.5
"""Fabric beyond the field on each side: it shadows the field and is reflected in it."""
GAUGE = 0.20
"""Distance of neighbouring warp yarns, and of neighbouring weft yarns."""
STRIP_WIDTH = 1.0
"""Width of a gold strip."""
STRIP_HEIGHT = 0.24
"""Height of the gold strips over the mean surface."""
STRIPS = (2.55, 3.95)
"""Centres of the gold strips above the lower edge of a repeat."""
FLOAT_GAUGE = 0.135
"""Distance of neighbouring threads of the figure."""
STEP = 0.025
"""Distance of points along a yarn."""
BINDING = 5
"""Period of a strip's bindings: it passes under every fifth warp yarn."""

MATERIALS = ("red", "gold", "blue", "white")
MOTIFS = ("comma", "waves", "lozenges")
"""Figures that the floats draw."""


@dataclass(frozen=True)
class Surface:
    """A grid of points with a material.

    Attributes
    ----------
    points, normals
        (n, m, 3); millimetres and unit vectors.
    uv
        (n, m, 2); surface coordinates, u along the first axis of a strip and around a yarn.
    material
        Index of the material in `MATERIALS`.
    """

    points: Array
    normals: Array
    uv: Array
    material: int

    def faces(self) -> NDArray[np.uint32]:
        """Return the triangles (k, 3) of the grid, as indices into its flattened points."""
        n, m = self.points.shape[:2]
        a = (np.arange(n - 1)[:, None] * m + np.arange(m - 1)).ravel()
        b, c, d = a + 1, a + m, a + m + 1
        return np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]).astype(np.uint32)


def weave(field_mm: float, seed: int, motif: str = "comma") -> list[Surface]:
    """Return the surfaces of a square of brocade with its margin.

    Parameters
    ----------
    field_mm
        Side of the square that the camera sees.
    seed
        Seed of the irregularities of the yarns and strips.
    motif
        Figure of the floats, one of `MOTIFS`.
    """
    rng = np.random.default_rng(seed)
    low, high = -field_mm / 2 - MARGIN, field_mm / 2 + MARGIN
    warps = np.arange(low, high, GAUGE) + GAUGE / 2
    rows = _strip_rows(low, high)
    wefts = np.array([y for y in np.arange(low, high, GAUGE) if all(abs(y - r) > STRIP_WIDTH / 2 + 0.06 for r in rows)])
    strips = [_strip(y, k, warps, low, high, rng) for k, y in enumerate(rows)]
    surfaces = list(strips)
    surfaces += [_warp(j, warps, wefts, strips, low, high, rng) for j in range(len(warps))]
    surfaces += [_weft(i, y, warps, low, high, rng) for i, y in enumerate(wefts)]
    surfaces += [_float(x0, x1, y, material, rng) for x0, x1, y, material in _figure(low, high, motif)]
    return surfaces


def _strip_rows(low: float, high: float) -> list[float]:
    repeats = range(int(np.floor(low / REPEAT)) - 1, int(np.ceil(high / REPEAT)) + 1)
    rows = [REPEAT * (k - 0.5) + y for k in repeats for y in STRIPS]
    return [y for y in rows if low - STRIP_WIDTH / 2 < y < high + STRIP_WIDTH / 2]


def _rough(rng: np.random.Generator, x: Array, smooth: float, slope: float) -> Array:
    """Return a random profile over x, smoothed over `smooth` steps, whose slope has the standard deviation `slope`."""
    profile = gaussian_filter1d(rng.normal(size=len(x)), smooth)
    return profile / np.gradient(profile, x).std() * slope


def _strip(y: float, k: int, warps: Array, low: float, high: float, rng: np.random.Generator) -> Surface:
    """Return a gold strip along the weft, which waves, rolls from side to side and is wrinkled at two scales."""
    x, across = np.arange(low, high, 0.0125), np.linspace(-STRIP_WIDTH / 2, STRIP_WIDTH / 2, 65)
    roll = gaussian_filter1d(rng.normal(size=len(x)), 45)
    roll *= np.radians(8) / roll.std()
    z = STRIP_HEIGHT + 0.6 * _rough(rng, x, 38, np.tan(np.radians(6)))[:, None] + np.tan(roll)[:, None] * across
    z = z - 0.04 * (across / (STRIP_WIDTH / 2)) ** 2
    for smooth, slope in (((5.6, 3.2), 0.05), ((1.6, 1.6), 0.03)):
        wrinkles = gaussian_filter(rng.normal(size=z.shape), smooth)
        z += wrinkles / np.gradient(wrinkles, x, axis=0).std() * slope
    for j, warp in enumerate(warps):
        if _binds(j, k):
            z -= 0.035 * np.exp(-(((x - warp) / 0.10) ** 2))[:, None]
    points = np.stack(np.broadcast_arrays(x[:, None], y + across, z), -1)
    normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    uv = np.stack(np.broadcast_arrays(x[:, None], across), -1)
    return Surface(points, normals / np.linalg.norm(normals, axis=-1, keepdims=True), uv, 1)


def _binds(warp: int, strip: int) -> bool:
    return (warp + 2 * strip) % BINDING == 0


def _warp(
    j: int,
    warps: Array,
    wefts: Array,
    strips: list[Surface],
    low: float,
    high: float,
    rng: np.random.Generator,
) -> Surface:
    """Return a warp yarn: in plain weave with the weft yarns, and under the strips except at its bindings."""
    knots = {y: 0.055 if (i + j) % 2 else -0.055 for i, y in enumerate(wefts)}
    for k, strip in enumerate(strips):
        column = strip.points[np.argmin(np.abs(strip.points[:, 0, 0] - warps[j]))]
        for y in column[0, 1] + (STRIP_WIDTH / 2) * np.array([0.1, 0.5, 1.0, 1.5, 1.9]):
            over = np.interp(y, column[:, 1], column[:, 2]) + 0.062
            knots[y] = over if _binds(j, k) else -0.02
    at = np.array(sorted(knots))
    y = np.arange(low, high, STEP)
    height = PchipInterpolator(at, [knots[v] for v in at])(np.clip(y, at[0], at[-1]))
    x = warps[j] + 0.05 * gaussian_filter1d(rng.normal(size=len(y)), 15)
    return _yarn(np.stack([x, y, gaussian_filter1d(height, 2)], 1), 0.088, 0.062, 0, 0, rng)


def _weft(i: int, y: float, warps: Array, low: float, high: float, rng: np.random.Generator) -> Surface:
    x = np.arange(low, high, STEP)
    z = np.interp(x, warps, [-0.055 if (i + j) % 2 else 0.055 for j in range(len(warps))])
    line = y + 0.05 * gaussian_filter1d(rng.normal(size=len(x)), 15)
    return _yarn(np.stack([x, line, gaussian_filter1d(z, 2.5)], 1), 0.088, 0.062, 1, 0, rng)


def _float(x0: float, x1: float, y: float, material: int, rng: np.random.Generator) -> Surface:
    """Return a pattern thread that floats over the ground from x0 to x1 and dives under it at both ends."""
    x = np.linspace(x0, x1, max(int((x1 - x0) / STEP), 8) + 8)
    end = np.minimum(x - x0, x1 - x)
    z = 0.16 + 0.03 * np.sin(2 * np.pi * x / 0.9 + rng.uniform(0, 6.28)) - 0.20 * np.exp(-end / 0.06)
    line = y + 0.004 * gaussian_filter1d(rng.normal(size=len(x)), 2)
    return _yarn(np.stack([x, line, z], 1), 0.075, 0.06, 1, material, rng)


def _yarn(
    centre: Array, half_width: float, half_height: float, axis: int, material: int, rng: np.random.Generator
) -> Surface:
    """Return a tube around a centre line (n, 3) along Y (axis 0) or X (axis 1), ridged by twisted fibres."""
    around = 32
    tangent = np.gradient(centre, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.eye(3)[axis]
    up = np.cross(side, tangent) if axis == 0 else np.cross(tangent, side)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    angle = np.arange(around) / around * 2 * np.pi
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(centre, axis=0), axis=1))])
    twisted = angle + 3.0 * length[:, None]
    radius = 1 + 0.06 * gaussian_filter(rng.normal(size=twisted.shape), (4, 0.7), mode="wrap")
    for fibres in range(4, 8):
        radius += 0.025 * rng.normal() * np.cos(fibres * twisted + rng.uniform(0, 2 * np.pi))
    radius = radius[..., None]
    across, over = (
        half_width * np.cos(angle)[:, None] * side,
        half_height * np.sin(angle)[:, None] * up[:, None],
    )
    points = centre[:, None] + radius * (across + over)
    normals = np.cross(np.roll(points, -1, 1) - np.roll(points, 1, 1), np.gradient(points, axis=0))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= np.sign(np.sum(normals * (points - centre[:, None]), -1).mean())
    uv = np.stack(np.broadcast_arrays(np.append(angle, 2 * np.pi) / (2 * np.pi), length[:, None]), -1)
    seam = np.append(np.arange(around), 0)
    return Surface(points[:, seam], normals[:, seam], uv, material)


def _figure(low: float, high: float, motif: str) -> Iterator[tuple[float, float, float, int]]:
    """Yield the floats (x0, x1, y, material) of the figure."""
    x = np.arange(0, REPEAT, 0.01)
    repeats = range(int(np.floor(low / REPEAT)), int(np.ceil(high / REPEAT)) + 1)
    for y in np.arange(0.15, 1.75, FLOAT_GAUGE):
        for inside, material in zip(_row(motif, x, y), (2, 3), strict=True):
            edges = np.flatnonzero(np.diff(inside.astype(int), prepend=0, append=0))
            for start, end in edges.reshape(-1, 2):
                x0, x1 = start * 0.01, end * 0.01
                if x1 - x0 > 0.15:
                    for i in repeats:
                        for j in repeats:
                            shift = REPEAT * (np.array([i, j]) - 0.5)
                            if low < x0 + shift[0] and x1 + shift[0] < high and low < y + shift[1] < high:
                                yield x0 + shift[0], x1 + shift[0], y + shift[1], material


def _row(motif: str, x: Array, y: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where blue and white floats lie in the row at y of a repeat.

    The comma has a sail beside it. The waves are arcs about a point at the lower left, beside a sail, too. The lozenges
    grow from left to right, and the second one is white.
    """
    if motif == "waves":
        distance = np.hypot(x - 0.9, y)
        return (distance % 0.9 < 0.42) & (x < 2.9 + 0.6 * y), (x > 3.35 + 0.6 * y) & (x < 4.45)
    if motif == "lozenges":
        blue, white = np.zeros(x.shape, bool), np.zeros(x.shape, bool)
        for centre, half, into in ((0.6, 0.45, blue), (1.7, 0.6, white), (3.3, 0.95, blue)):
            into |= np.abs(x - centre) / half + np.abs(y - 0.95) / 0.85 < 1
        return blue, white
    head = (x - 1.05) ** 2 + (y - 0.62) ** 2 < 0.45**2
    tail = (np.hypot(x - 1.25, y - 0.85) < 0.85) & (np.hypot(x - 1.02, y - 1.22) > 0.72) & (x > 1.05)
    sail = (x > 2.85 + 0.75 * (y - 0.15)) & (x < 4.25)
    return head | tail, sail
