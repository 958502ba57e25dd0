"""Height of the fabric from its own views: features that views share are triangulated and fitted by a smooth surface.

The views are first brought to the surface that is known so far (the plane of the board, then the fitted height).
There a thread looks alike from 0° and from 60°, and in each view the rest of its shift lies along one line, so that a
feature has few candidates. Between the photographs as they are, SIFT finds little beyond 40°.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from kinran.base.files import InputError
from kinran.register.cameras import Cameras
from kinran.register.rectify import Grid, Image, rectify

Array = NDArray[np.float64]

REACH = 1 / 12
"""Largest height that is searched, as a share of the field's shorter side: 8 mm over a field of 100 mm, several times
the sag of a cloth under a plate. No measurement stands behind the share."""
AGAIN = 1 / 5
"""Share of that reach in the second pass, around the height that the first found: only relief is left then, and fewer
candidates make fewer wrong matches. No measurement stands behind the share."""
ASIDE = 1.5
"""Texels that a match may lie off its epipolar line: a few times the error of cameras and features, which are under
half a texel each. No measurement stands behind the number."""
RATIO = 0.8
"""Largest ratio of the distances of the best and the second candidate's descriptors [Lowe2004]."""
FEATURES = 12_000
"""Most features of a view, the strongest first: in a simulated session of 13 views they gave 8000 points."""
BLOCK = 1024
"""Features that are matched at a time, so that the mask of candidates takes tens of MB; results do not depend on it."""
KNOTS = 48
"""Knots of the spline along the field's longer side: one each 2.1 mm over a field of 100 mm. It follows sag,
wrinkles and raised motifs, and a thread's own relief is below it (docs/register.md has the bounds that tests hold)."""
STIFF = 0.05
"""Weight of the spline's second differences beside a point of median certainty: enough to close gaps between points
without flattening relief. No measurement stands behind the weight."""
DOUBT = 1.0
"""Standard deviations, each the height that a pixel is worth, within which no point counts as an outlier: on smooth
cloth the relief of motifs would else be one. No measurement stands behind the number."""
POINTS = 100
"""Fewest points that a surface is fitted to: far under what any textured cloth gives. No measurement stands behind
it."""


@dataclass(frozen=True)
class Points:
    """Triangulated points of the fabric.

    Attributes
    ----------
    xyz : (n, 3) float
        Positions in mm.
    sigma : (n,) float
        Standard deviation of the height in mm, for a pixel's error in every ray.
    views : (n,) int
        Number of views that show the point.
    """

    xyz: Array
    sigma: Array
    views: NDArray[np.int64]


@dataclass(frozen=True)
class Spline:
    """Bicubic B-spline z(x, y) over the field.

    Attributes
    ----------
    x, y : (knot,) float
        Knots in mm.
    coefficients : (y, x) float
    """

    x: Array
    y: Array
    coefficients: Array

    def on(self, grid: Grid) -> Array:
        """Height (y, x) in mm on a grid."""
        return np.asarray(_basis(self.y, grid.y) @ (_basis(self.x, grid.x) @ self.coefficients.T).T)

    def at(self, xy: Array) -> Array:
        """Height (n,) in mm at points (n, 2)."""
        return np.asarray(_rows(self.x, self.y, xy) @ self.coefficients.ravel())


@dataclass(frozen=True)
class Surface:
    """The fabric's surface.

    Attributes
    ----------
    height : (y, x) float
        Height in mm over the board's plane.
    points
        Points that it was fitted to.
    residual : (n,) float
        Heights of the points over the surface, in mm.
    """

    height: Array
    points: Points
    residual: Array


def measure(cameras: Cameras, pictures: list[Image], grid: Grid) -> Surface:
    """Find the surface of the fabric.

    Parameters
    ----------
    cameras
        Calibrated cameras.
    pictures : view × (y, x) float32
        Grey in [0, 1], evenly spaced to the eye (not linear), top row first.
    grid
        Texels whose height is wanted.

    Raises
    ------
    InputError
        The views show too little of the fabric in common.
    """
    height = np.zeros((grid.height, grid.width))
    reach = REACH * min(grid.width, grid.height) * grid.texel
    for span in (reach, reach * AGAIN):
        points = triangulate(cameras, *tracks(cameras, pictures, grid, height, span))
        if len(points.xyz) < POINTS:
            raise InputError(
                f"{', '.join(cameras.names)}: only {len(points.xyz)} points of the fabric are found in common, "
                f"but {POINTS} are needed; add views between the front and the steepest, sharp and evenly lit"
            )
        spline = fit(points, grid)
        height = spline.on(grid)
    return Surface(height, points, points.xyz[:, 2] - spline.at(points.xyz[:, :2]))


def features(picture: Image) -> tuple[Array, Image]:
    """SIFT features of a rectified grey picture in [0, 1]: positions (n, 2) in texels from 0, descriptors (n, 128).

    All are upright, since rectified views are not turned against each other [Lowe2004].
    """
    sift = cv2.SIFT.create(nfeatures=FEATURES, contrastThreshold=0.01, enable_precise_upscale=True)
    coded = np.round(255 * np.clip(picture, 0, 1)).astype(np.uint8)
    unique = {(point.pt, point.size): point for point in sift.detect(coded, None)}
    points = list(unique.values())
    for point in points:
        point.angle = 0.0
    if not points:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    kept, descriptors = sift.compute(coded, points)
    return np.array([point.pt for point in kept], float), np.asarray(descriptors, np.float32)


def tracks(
    cameras: Cameras, pictures: list[Image], grid: Grid, height: Array, reach: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Match the features of the front view in the other views, on the surface that is known so far.

    Parameters
    ----------
    cameras, pictures, grid
        Cameras, grey pictures and texels, as in `measure`.
    height : (y, x) float
        Height that is known so far, in mm.
    reach
        Largest distance, in mm, of the fabric from that surface.

    Returns
    -------
    positions : (feature, view, 3) float
        The point of the known surface behind which the view sees the feature, in mm.
    seen : (feature, view) bool
        Whether the view shows the feature.
    """
    surface = grid.surface(height)
    front, wanted = features(rectify(cameras, 0, pictures[0], grid, height))
    positions = np.zeros((len(front), len(pictures), 3))
    seen = np.zeros((len(front), len(pictures)), bool)
    if len(front) == 0:
        return positions, seen
    anchors = _lookup(surface, front)
    positions[:, 0], seen[:, 0] = anchors, True
    for view in range(1, len(pictures)):
        found, descriptors = features(rectify(cameras, view, pictures[view], grid, height))
        if len(found) < 2:
            continue
        places = _lookup(surface, found)
        lean = _lean(cameras, view, anchors) - _lean(cameras, 0, anchors)
        pairs = _match(anchors, wanted, places, descriptors, lean, reach, ASIDE * grid.texel)
        positions[pairs[:, 0], view], seen[pairs[:, 0], view] = places[pairs[:, 1]], True
    return positions, seen


def _lookup(surface: Array, texels: Array) -> Array:
    """Points (n, 3) of a surface (y, x, 3) at texels (n, 2), linearly between them."""
    x, y = (np.ascontiguousarray(texels[:, k : k + 1], np.float32) for k in range(2))
    return np.stack([cv2.remap(surface[..., k], x, y, cv2.INTER_LINEAR)[:, 0] for k in range(3)], -1)


def _lean(cameras: Cameras, view: int, points: Array) -> Array:
    """Shift (n, 2) in mm at which a view sees a point for each mm of its height."""
    away = points - cameras.centres[view]
    return np.asarray(-away[:, :2] / away[:, 2:])


def _match(
    anchors: Array, wanted: Image, places: Array, descriptors: Image, lean: Array, reach: float, aside: float
) -> NDArray[np.int64]:
    """Pairs (n, 2) of front feature and view feature, each in one pair at most.

    A candidate lies on the line of `lean` from the anchor, at a height within `reach`.
    """
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    length = np.linalg.norm(lean, axis=1)
    along, across = lean / length[:, None], np.stack([-lean[:, 1], lean[:, 0]], -1) / length[:, None]
    best: dict[int, tuple[float, int]] = {}
    for start in range(0, len(anchors), BLOCK):
        block = slice(start, start + BLOCK)
        away = (places[None, :, :2] - anchors[block, None, :2]).astype(np.float32)
        near = np.abs(np.einsum("nmk,nk->nm", away, across[block])) < aside
        near &= np.abs(np.einsum("nmk,nk->nm", away, along[block])) < reach * length[block, None] + aside
        for candidates in matcher.knnMatch(wanted[block], descriptors, 2, near.astype(np.uint8)):
            if not candidates or (len(candidates) == 2 and candidates[0].distance > RATIO * candidates[1].distance):
                continue
            match = candidates[0]
            if match.trainIdx not in best or match.distance < best[match.trainIdx][0]:
                best[match.trainIdx] = (match.distance, start + match.queryIdx)
    return np.array([(front, other) for other, (_, front) in best.items()], np.int64).reshape(-1, 2)


def triangulate(cameras: Cameras, positions: Array, seen: NDArray[np.bool_]) -> Points:
    """Find the points nearest to their rays, robustly; those near to fewer than two or three rays are dropped.

    Parameters
    ----------
    cameras
        Calibrated cameras.
    positions : (n, view, 3) float
        A point on each ray, in mm.
    seen : (n, view) bool
        Whether the view shows the point.
    """
    centres = cameras.centres
    pixel = cameras.pixel_mm(0)
    rays = positions - centres
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    least = 2 if len(cameras.names) < 4 else 3
    enough = seen.sum(1) >= least
    seen, rays, across, base = seen[enough], rays[enough], across[enough], positions[enough, 0]
    weight, points, normal = seen.astype(float), base.copy(), np.zeros((len(base), 3, 3))
    gap = np.einsum("nvij,vj->nvi", across, centres)
    for _ in range(8):
        normal = np.einsum("nv,nvij->nij", weight, across) + 1e-9 * np.eye(3)
        points = np.linalg.solve(normal, np.einsum("nv,nvi->ni", weight, gap)[..., None])[..., 0]
        miss = np.linalg.norm(np.einsum("nvij,nvj->nvi", across, points[:, None] - centres), axis=-1)
        weight = seen / (1 + (miss / pixel) ** 2) ** 2
    sigma = pixel * np.sqrt(np.linalg.inv(normal)[:, 2, 2])
    good = ((miss < pixel) & seen).sum(1) >= least
    return Points(points[good], sigma[good], seen[good].sum(1))


def fit(points: Points, grid: Grid) -> Spline:
    """Fit a smooth surface to points, with robust weights.

    Least squares of the heights with the spline's second differences held small; points far off for their σ count
    less (Cauchy weights), in eight rounds.
    """
    size = (grid.width * grid.texel, grid.height * grid.texel)
    step = max(size) / KNOTS
    x, y = (_knots(length, step) for length in size)
    inside = (np.abs(points.xyz[:, :2]) < np.array(size) / 2).all(1)
    xy, z = points.xyz[inside, :2], points.xyz[inside, 2]
    sure = (np.median(points.sigma[inside]) / points.sigma[inside]) ** 2
    matrix = _rows(x, y, xy)
    nx, ny = len(x) - 4, len(y) - 4
    bend_x, bend_y = (sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(n - 2, n)) for n in (nx, ny))
    bend = sparse.vstack([sparse.kron(sparse.eye_array(ny), bend_x), sparse.kron(bend_y, sparse.eye_array(nx))])
    stiffness = STIFF * bend.T @ bend + 1e-9 * sparse.eye_array(nx * ny)
    weight = sure
    for _ in range(8):
        weighted = matrix.T * weight
        solution = scipy.sparse.linalg.spsolve((weighted @ matrix + stiffness).tocsc(), weighted @ z)
        miss = (z - matrix @ solution) / points.sigma[inside]
        scale = max(2 * 1.4826 * float(np.median(np.abs(miss))), DOUBT)
        weight = sure / (1 + (miss / scale) ** 2)
    return Spline(x, y, np.asarray(solution).reshape(ny, nx))


def _knots(length: float, step: float) -> Array:
    inner = np.linspace(-length / 2, length / 2, max(round(length / step), 2) + 1)
    return np.concatenate([[inner[0]] * 3, inner, [inner[-1]] * 3])


def _basis(knots: Array, positions: Array) -> "sparse.csr_array":
    edge = np.nextafter(knots[-1], 0)
    return sparse.csr_array(BSpline.design_matrix(np.clip(positions, knots[0], edge), knots, 3))


def _rows(x: Array, y: Array, xy: Array) -> "sparse.csr_array":
    """Rows of the tensor product's design matrix, (n, y·x): 16 entries each."""
    across, up = _basis(x, xy[:, 0]), _basis(y, xy[:, 1])
    n = len(xy)
    columns = up.indices.reshape(n, 4, 1).astype(np.int64) * (len(x) - 4) + across.indices.reshape(n, 1, 4)
    values = up.data.reshape(n, 4, 1) * across.data.reshape(n, 1, 4)
    shape = (n, (len(x) - 4) * (len(y) - 4))
    return sparse.csr_array((values.ravel(), columns.ravel(), np.arange(0, 16 * n + 1, 16)), shape=shape)
