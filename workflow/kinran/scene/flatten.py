"""A sheet of triangles and its chart: outline, normals, flattening, and the direction of the weft.

Vertices are (n, 3) float, faces (m, 3) int, counter-clockwise seen from the front.
"""

import igl
import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu
from scipy.spatial import ConvexHull

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

SLIM_STEPS = 25
"""Steps of the solver. The tests hold lengths in the chart to 0.3 mm of arc length on cloth without a bump; more steps
were not compared."""
MIDDLE = 0.45
"""Half of the share of a side from which its direction is found: the outer 5 % at each end, where corners are cut or
frayed, are left out. No measurement stands behind the share."""


def half_edges(faces: Faces) -> Faces:
    """Start and end of every face's edges in turn, (3m, 2) int."""
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def crosses(vertices: Array, faces: Faces) -> Array:
    """Normals of the faces times twice their area, (m, 3)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def vector_area(vertices: Array, faces: Faces) -> Array:
    """Sum of the faces' normals times areas, (3,): points out of the front of a sheet."""
    return np.asarray(crosses(vertices, faces).sum(0) / 2)


def vertex_normals(vertices: Array, faces: Faces) -> Array:
    """Unit normals at the vertices (n, 3), weighted by the faces' areas."""
    normals = np.zeros_like(vertices)
    weighted = crosses(vertices, faces)
    for k in range(3):
        np.add.at(normals, faces[:, k], weighted)
    return np.asarray(normals / np.linalg.norm(normals, axis=-1, keepdims=True))


def boundary_loops(faces: Faces) -> list[NDArray[np.int64]]:
    """Vertices of each run of edges that have one face, (k,) int each, unordered; longest run first."""
    edges = np.sort(half_edges(np.asarray(faces, np.int64)), axis=1)
    unique, counts = np.unique(edges, axis=0, return_counts=True)
    rim = unique[counts == 1]
    if not len(rim):
        return []
    vertices, local = np.unique(rim, return_inverse=True)
    local = local.reshape(-1, 2)
    graph = coo_matrix((np.ones(len(rim)), (local[:, 0], local[:, 1])), (len(vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    return sorted((vertices[label == k] for k in range(count)), key=len, reverse=True)


def unwrap(vertices: Array, faces: Faces) -> Array:
    """Flatten a sheet to one chart that keeps lengths and never folds over.

    The search starts from an embedding in a disc, in which no face can flip [Tutte1963], and lowers the symmetric
    Dirichlet energy from there without ever crossing a flip (SLIM) [Rabinovich2017]. A conformal map followed
    by ARAP stretches cloth as little, but leaves single faces folded over on rougher scans, and SLIM cannot
    mend a conformal start that has such faces.

    Parameters
    ----------
    vertices : (n, 3) float
    faces : (m, 3) int
        One manifold disc.

    Returns
    -------
    (n, 2) float
        Right-handed seen from the front, in the unit of `vertices`, in some rotation.
    """
    start = np.asfortranarray(_disc(vertices, faces))
    none, nowhere = np.zeros(0, np.int32), np.asfortranarray(np.zeros((0, 2)))
    data = igl.slim_precompute(
        np.asfortranarray(vertices),
        np.asfortranarray(faces, np.int32),
        start,
        igl.SYMMETRIC_DIRICHLET,
        none,
        nowhere,
        0.0,
    )
    return np.array(igl.slim_solve(data, SLIM_STEPS)[:, :2])


def _disc(vertices: Array, faces: Faces) -> Array:
    """Embed a sheet in a disc of its own area: outline on the circle, each vertex at its neighbours' mean."""
    loop = np.asarray(igl.boundary_loop(faces))
    lengths = np.linalg.norm(vertices[loop] - vertices[np.roll(loop, 1)], axis=-1)
    turn = 2 * np.pi * np.cumsum(lengths) / lengths.sum()
    n = len(vertices)
    edges = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
    graph = coo_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), (n, n)).tocsr()
    laplace = (diags_array(np.asarray((graph + graph.T).sum(0)).ravel()) - graph - graph.T).tocsr()
    inner = np.setdiff1d(np.arange(n), loop)
    uv = np.zeros((n, 2))
    uv[loop] = np.stack([np.cos(turn), np.sin(turn)], -1)
    uv[inner] = splu(laplace[inner][:, inner].tocsc()).solve(-(laplace[inner][:, loop] @ uv[loop]))
    area = np.linalg.norm(crosses(vertices, faces), axis=-1).sum() / 2
    return np.asarray(uv * np.sqrt(area / np.pi))


def _gradients(vertices: Array, faces: Faces, uv: Array) -> tuple[Array, Array, Array]:
    """Per face: frames (m, 3, 2) in space, Jacobians (m, 2, 2) of uv over the frame, areas (m,)."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = crosses(vertices, faces)
    area = np.linalg.norm(normal, axis=-1) / 2
    x = (b - a) / np.linalg.norm(b - a, axis=-1, keepdims=True)
    y = np.cross(normal / (2 * area[:, None]), x)
    frame = np.stack([x, y], -1)
    local = np.einsum("mkj,mki->mij", np.stack([b - a, c - a], -1), frame)
    chart = np.stack([uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]], -1)
    return frame, chart @ np.linalg.inv(local), area


def chart_directions(vertices: Array, faces: Faces, uv: Array) -> tuple[Array, Array]:
    """Directions of growing u and of growing v on each face, (m, 3) each, not normalised."""
    frame, jacobian, _ = _gradients(vertices, faces, uv)
    both = frame @ np.linalg.inv(jacobian)
    return both[..., 0], both[..., 1]


def stretch(vertices: Array, faces: Faces, uv: Array) -> tuple[float, float, int]:
    """Mean and 99th percentile over the area of max(σ₁, 1/σ₂), and the number of flipped faces of a chart."""
    _, jacobian, area = _gradients(vertices, faces, uv)
    singular = np.linalg.svd(jacobian, compute_uv=False)
    worst = np.maximum(singular[:, 0], 1 / np.maximum(singular[:, 1], 1e-9))
    order = np.argsort(worst)
    share = np.cumsum(area[order]) / area.sum()
    p99 = worst[order][min(np.searchsorted(share, 0.99), len(order) - 1)]
    return float((area * worst).sum() / area.sum()), float(p99), int((np.linalg.det(jacobian) <= 0).sum())


def side_angles(outline: Array) -> tuple[Array, Array]:
    """Directions of the four sides of a panel that is about a rectangle.

    The minimum-area rectangle assigns each outline point to a side; the median slope of a side's points [Sen1968] is
    its direction, whatever a ragged or cut corner does to the rectangle.

    Parameters
    ----------
    outline : (k, 2) float
        Points on the outline in the chart, in any order.

    Returns
    -------
    angles : (4,) float
        Radians from +u: the two shorter sides, then the two longer ones; modulo π.
    lengths : (4,) float
        Lengths of the rectangle's sides, in the same order.
    """
    angle, low, high = _rectangle(outline)
    x, y = (outline @ _turn(angle) - (low + high) / 2).T
    width, height = high - low
    beside = np.abs(x) / width > np.abs(y) / height
    sides = []
    for end in (x < 0, x > 0):
        middle = beside & end & (np.abs(y) < MIDDLE * height)
        sides.append((height, angle + np.pi / 2 - _slope(y[middle], x[middle])))
    for end in (y < 0, y > 0):
        middle = ~beside & end & (np.abs(x) < MIDDLE * width)
        sides.append((width, angle + _slope(x[middle], y[middle])))
    sides.sort(key=lambda side: side[0])
    return np.array([angle for _, angle in sides]), np.array([length for length, _ in sides])


def _turn(angle: float) -> Array:
    """Matrix (2, 2) that turns row vectors by -angle."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin], [sin, cos]])


def _rectangle(points: Array) -> tuple[float, Array, Array]:
    """Minimum-area rectangle: its angle, and its low and high corner when it is turned back by that."""
    hull = points[ConvexHull(points).vertices]
    edges = np.roll(hull, -1, axis=0) - hull
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    boxes = [hull @ _turn(angle) for angle in angles]
    best = int(np.argmin([np.ptp(box, axis=0).prod() for box in boxes]))
    return float(angles[best]), boxes[best].min(0), boxes[best].max(0)


def _slope(x: Array, y: Array) -> float:
    """Angle of the line through points, from the median of the slopes of all pairs."""
    some = slice(None, None, len(x) // 400 + 1)
    right, up = (np.subtract.outer(values[some], values[some]) for values in (x, y))
    return float(np.arctan(np.median(up[right > 0] / right[right > 0])))


def turn_to_weft(uv: Array, outline: Faces) -> tuple[Array, Array]:
    """Turn a chart so that its shorter sides run along u, the lower left corner at (0, 0).

    Parameters
    ----------
    uv : (n, 2) float
    outline : (k,) int
        Vertices on the outline.

    Returns
    -------
    uv : (n, 2) float
        The turned chart, right up to a half turn.
    residuals : (4,) float
        Radians between each side and the weft or warp direction that all four agree on: the uncertainty of the weft.
    """
    angles, lengths = side_angles(uv[outline])
    from_weft = angles - np.array([0, 0, np.pi / 2, np.pi / 2])
    turn = np.angle((lengths * np.exp(2j * from_weft)).sum()) / 2
    residuals = np.angle(np.exp(2j * (from_weft - turn))) / 2
    turned = uv @ _turn(float(turn))
    return turned - turned.min(0), residuals


def quarter_turns(uv: Array, turns: int) -> Array:
    """A chart turned by 90° `turns` times, its lower left corner at (0, 0)."""
    for _ in range(turns):
        uv = uv @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    return np.asarray(uv - uv.min(0))


def hang(vertices: Array, faces: Faces, uv: Array) -> Array:
    """Rigid motion (4, 4) that hangs a panel: warp to +y, front to +z, middle of its box at the origin."""
    _, v = chart_directions(vertices, faces, uv)
    area = np.linalg.norm(crosses(vertices, faces), axis=-1, keepdims=True)
    up = (v * area).sum(0)
    up /= np.linalg.norm(up)
    front = vector_area(vertices, faces)
    front -= up * (up @ front)
    front /= np.linalg.norm(front)
    rotation = np.stack([np.cross(up, front), up, front])
    turned = vertices @ rotation.T
    motion = np.eye(4)
    motion[:3, :3] = rotation
    motion[:3, 3] = -(turned.min(0) + turned.max(0)) / 2
    return motion
