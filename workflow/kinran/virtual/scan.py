"""Generate the scan of a draped panel of cloth, which the `mesh` stage cleans where there is no scanner.

A loom width of cloth hangs in slanted folds with a slight bump that no flat sheet can follow. The scan has
what range scans have: noise along the line of sight, holes, ragged edges, floating islands, parts scanned
twice, fins, faces turned round, and a pose that has nothing to do with the weave.
"""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from kinran.base.checksums import comment
from kinran.base.files import atomic

Array = NDArray[np.float64]
Faces = NDArray[np.int64]

WIDTH, LENGTH = 60.0, 90.0
"""Size of the panel in mm along weft and warp: made up, like all numbers here."""
PITCH = 0.5
"""Distance of neighbouring samples in mm; finer ones would only make the demo slower."""
NOISE = 0.03
"""Standard deviation of range noise in mm along the line of sight, meant for a laser scanner. No measurement stands
behind it."""
SLANT = np.radians(9.0)
"""Angle between folds and warp in radians, so that the folds do not reveal the weft."""
BUMP_HEIGHT, BUMP_SIGMA = 1.2, 9.0
"""Height and standard deviation in mm of the bump that no flat sheet can follow."""
SENSOR = np.array([0.0, 0.0, 1.0])
"""Direction towards the scanner, in the scan's coordinates."""


@dataclass(frozen=True)
class Truth:
    """The surface that the scan was made from, sampled without noise, in the scan's coordinates.

    Attributes
    ----------
    points : (n, 3) float
        Points on the surface in mm.
    uv : (n, 2) float
        Arc length along weft and warp from the lower left corner in mm.
    weft : (n, 3) float
        Unit directions of the weft.
    """

    points: Array
    uv: Array
    weft: Array


def drape(uv: Array) -> Array:
    """Return points of the hanging cloth.

    Parameters
    ----------
    uv : (..., 2) float
        Weft and warp coordinate in mm, from the lower left corner.

    Returns
    -------
    (..., 3) float
        Points in mm: x to the right, y up, z to the viewer. Arc length is kept except under the bump.
    """
    u, v = uv[..., 0] - WIDTH / 2, uv[..., 1] - LENGTH / 2
    across, along = np.cos(SLANT) * u + np.sin(SLANT) * v, np.cos(SLANT) * v - np.sin(SLANT) * u
    s = np.linspace(-80.0, 80.0, 6401)
    fold = 0.62 * np.sin(2 * np.pi * s / 24 + 0.6) + 0.36 * np.sin(2 * np.pi * s / 43 + 2.4)
    steps = np.diff(s, prepend=s[0])
    x, z = np.cumsum(np.cos(fold) * steps), np.cumsum(np.sin(fold) * steps)
    x, z = x - np.interp(0.0, s, x), z - z.mean()
    tilt = np.interp(across, s, fold)
    bump = BUMP_HEIGHT * np.exp(-((u + 6) ** 2 + (v - 8) ** 2) / (2 * BUMP_SIGMA**2))
    folded_x = np.interp(across, s, x) - np.sin(tilt) * bump
    folded_z = np.interp(across, s, z) + np.cos(tilt) * bump
    cos, sin = np.cos(SLANT), np.sin(SLANT)
    return np.stack([cos * folded_x - sin * along, sin * folded_x + cos * along, folded_z], -1)


def scan(seed: int = 0) -> tuple[Array, Faces, Truth]:
    """Scan the hanging cloth.

    Parameters
    ----------
    seed
        Seed of pose and faults; the same seed gives the same scan.

    Returns
    -------
    vertices : (n, 3) float
        Positions in mm. Most faces look towards the scanner, which stands on the +z side, and the cloth's upper
        edge is on the +y side.
    faces : (m, 3) int
    truth : Truth
        Surface that the scan was made from, for tests; it is not in the file.
    """
    rng = np.random.default_rng(seed)
    roll, *tilts = rng.uniform([-60, -20, -20], [60, 20, 20])
    pose = Rotation.from_euler("zyx", [roll, *tilts], degrees=True)
    shift = rng.uniform([-80, -80, -700], [80, 80, -500])

    uv, faces = _ragged_grid(rng)
    faces = _holes(faces, uv, rng)
    vertices = pose.apply(drape(uv)) + shift
    vertices += SENSOR * NOISE * rng.standard_normal((len(vertices), 1))
    for spoil in (_turn_faces, _fins, _islands, _scanned_twice):
        vertices, faces = spoil(vertices, faces, rng)
    return vertices, rng.permutation(faces), _truth(pose, shift)


def _truth(pose: Rotation, shift: Array) -> Truth:
    u, v = np.meshgrid(np.arange(0, WIDTH + 0.1, 0.25), np.arange(0, LENGTH + 0.1, 0.25))
    uv = np.stack([u, v], -1).reshape(-1, 2)
    step = np.array([1e-3, 0.0])
    weft = drape(uv + step) - drape(uv - step)
    weft /= np.linalg.norm(weft, axis=-1, keepdims=True)
    return Truth(pose.apply(drape(uv)) + shift, uv, pose.apply(weft))


def _ragged_grid(rng: np.random.Generator) -> tuple[Array, Faces]:
    """Return jittered samples of the panel, with gaps along its edge."""
    u, v = np.meshgrid(np.arange(0, WIDTH + PITCH / 2, PITCH), np.arange(0, LENGTH + PITCH / 2, PITCH))
    rows, columns = u.shape
    uv = np.stack([u, v], -1) + rng.uniform(-0.3, 0.3, (rows, columns, 2)) * PITCH
    uv = np.clip(uv, 0, [WIDTH, LENGTH]).reshape(-1, 2)
    i = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[:-1, 1:], i[1:, 1:], i[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    middle = uv[faces].mean(1)
    edge = np.minimum(middle, [WIDTH, LENGTH] - middle).min(-1) < PITCH
    return uv, faces[~edge | (rng.random(len(faces)) > 0.03)]


def _holes(faces: Faces, uv: Array, rng: np.random.Generator) -> Faces:
    """Cut five holes of a few millimetres, and pinholes."""
    middle = uv[faces].mean(1)
    centres = rng.uniform(8, [WIDTH - 8, LENGTH - 8], (5, 2))
    radii = rng.uniform(0.8, 2.2, 5)
    inside = np.linalg.norm(middle[:, None] - centres, axis=-1) < radii
    kept: Faces = faces[~inside.any(1) & (rng.random(len(faces)) > 0.001)]
    return kept


def _turn_faces(vertices: Array, faces: Faces, rng: np.random.Generator) -> tuple[Array, Faces]:
    """Reverse a few faces, and add a few of no area."""
    faces = faces.copy()
    faces[rng.choice(len(faces), 25, False)] = faces[rng.choice(len(faces), 25, False)][:, ::-1]
    flat = faces[rng.choice(len(faces), 6, False)][:, [0, 0, 1]]
    return vertices, np.concatenate([faces, flat])


def _fins(vertices: Array, faces: Faces, rng: np.random.Generator) -> tuple[Array, Faces]:
    """Add triangles that share an edge (three faces on it) or only a corner with the cloth."""
    hosts = faces[rng.choice(len(faces), 24, False)]
    tips = vertices[hosts[:, 0]] + rng.normal(0, PITCH, (24, 3))
    more = tips + rng.normal(0, PITCH, (24, 3))
    n = len(vertices)
    edge_fins = np.stack([hosts[:12, 0], hosts[:12, 1], n + np.arange(12)], -1)
    corner_fins = np.stack([hosts[12:, 0], n + np.arange(12, 24), n + 24 + np.arange(12, 24)], -1)
    return np.concatenate([vertices, tips, more]), np.concatenate([faces, edge_fins, corner_fins])


def _islands(vertices: Array, faces: Faces, rng: np.random.Generator) -> tuple[Array, Faces]:
    """Add scraps of surface that float around the cloth, as of clips and fingers."""
    for _ in range(7):
        host = vertices[faces[rng.integers(len(faces)), 0]]
        near = np.linalg.norm(vertices[faces].mean(1) - host, axis=-1) < rng.uniform(0.8, 2.5)
        used, scrap = np.unique(faces[near], return_inverse=True)
        away = rng.normal(0, 1, 3)
        moved = vertices[used] + away / np.linalg.norm(away) * rng.uniform(6, 25)
        faces = np.concatenate([faces, len(vertices) + scrap.reshape(-1, 3)])
        vertices = np.concatenate([vertices, moved])
    return vertices, faces


def _scanned_twice(vertices: Array, faces: Faces, rng: np.random.Generator) -> tuple[Array, Faces]:
    """Repeat a band as loose triangles, each with its own corners."""
    height = vertices[faces].mean(1)[:, 1]
    low = rng.uniform(0.2, 0.7)
    first, last = np.quantile(height, [low, low + 0.1])
    band = faces[(height > first) & (height < last)]
    loose = len(vertices) + np.arange(band.size).reshape(-1, 3)
    return np.concatenate([vertices, vertices[band].reshape(-1, 3)]), np.concatenate([faces, loose])


def write_scan(path: Path, vertices: Array, faces: Faces) -> None:
    """Write a scan (vertices (n, 3) in mm, faces (m, 3)) as ASCII PLY."""
    corners = np.insert(faces, 0, 3, axis=1)
    start = b"ply\nformat ascii 1.0\ncomment generated scan of a draped panel, mm\n"
    file = io.StringIO()
    file.write(
        f"element vertex {len(vertices)}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    np.savetxt(file, vertices, "%.4f")
    np.savetxt(file, corners, "%d")
    rest = file.getvalue().encode("ascii")
    with atomic(path) as temporary:
        temporary.write_bytes(start + f"comment {comment(start, rest)}\n".encode() + rest)


def main(
    out: Annotated[Path, "OUT", "scan to write (.ply)"],
    seed: Annotated[int, "another seed, another pose and other faults"] = 0,
) -> None:
    """Write the scan of a draped cloth."""
    vertices, faces, _ = scan(seed)
    write_scan(out, vertices, faces)
