"""Clean the scan of one panel of cloth and unwrap it so that +u runs along the weft, in millimetres.

Cleaning uses pymeshlab, in a process of its own: it is GPL, brings Qt and OpenGL with it, and a crash there
becomes one sentence here. The panel is unwrapped to one chart that keeps lengths, and turned so that its
shorter sides run along u: cloth is woven with the weft across the loom width and the warp along the length.
"""

import logging
import multiprocessing
import os
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from kinran.base.checksums import comment
from kinran.base.end_with_run import end_with_parent
from kinran.base.files import InputError, atomic, check_comment, sha256, write_json
from kinran.base.probes import PYMESHLAB_PLUGINS
from kinran.base.shared_results import made
from kinran.scene.flatten import (
    Array,
    Faces,
    boundary_loops,
    crosses,
    half_edges,
    hang,
    quarter_turns,
    stretch,
    turn_to_weft,
    unwrap,
    vector_area,
    vertex_normals,
)

log = logging.getLogger(__name__)

SUFFIXES = (".ply", ".obj", ".stl", ".off")
ISLAND = 0.05
"""Share of the faces under which a component is a stray scrap, such as a clip or a finger; two panels in one scan have
more each, and are refused. No measurement stands behind the share."""
FACES = 24_000
"""About as many triangles as the clean mesh has: on a panel of 60 × 90 mm their edges are 0.7 mm long, for folds of
centimetres. No measurement stands behind the number."""
SQUARE = 0.95
"""Ratio of the shorter side to the longer above which the sides do not tell the weft; the scan's upward direction does
then. No measurement stands behind the ratio."""
UNSURE = 5.0
"""Disagreement of the sides on the weft, in degrees, that is worth a warning. No measurement stands behind it."""
SMALLEST, LARGEST = 5.0, 10_000.0
"""Believable size of a panel in mm: a scan in metres or inches falls outside."""


@dataclass(frozen=True)
class Inputs:
    scan: Annotated[Path, "SCAN", "raw scan of one panel, in mm (PLY, OBJ, STL, OFF)"]


@dataclass(frozen=True)
class Outputs:
    mesh: Annotated[Path, "OUT", "clean, unwrapped mesh (.ply)"]
    report: Annotated[Path | None, "counts, size and stretch of the mesh (.json)"] = None


def main(inputs: Inputs, out: Outputs) -> None:
    """Clean and unwrap a scan, or take its mesh from those that are shared."""
    scan = inputs.scan
    check_scan(scan)
    found = made(
        "mesh",
        "kinran.scene.mesh",
        lambda: (sha256(scan), scan.suffix.lower(), out.report is None),
        {"mesh.ply": out.mesh, **({"mesh.json": out.report} if out.report else {})},
        lambda: prepare(scan, out.mesh, out.report),
    )
    unsure = found["weft_residual_degrees"]
    if unsure > UNSURE:
        log.warning("warning: %s: its weft is known to %.0f° only; it is no rectangle", scan, unsure)


def load_pymeshlab() -> Any:
    """The pymeshlab module.

    Raises
    ------
    InputError
        It is missing, or has lost plugins for want of a system library.
    """
    try:
        import pymeshlab
    except ImportError as error:
        raise InputError(
            f"pymeshlab: cannot be loaded ({error}); install libgl1 and libopengl0, then run kinran doctor"
        ) from None
    if pymeshlab.plugin_number() < PYMESHLAB_PLUGINS:
        raise InputError(
            f"pymeshlab: only {pymeshlab.plugin_number()} of {PYMESHLAB_PLUGINS} plugins loaded; "
            "install the system library libopengl0"
        )
    return pymeshlab


def check_scan(path: Path) -> None:
    """Check a scan's name, and a PLY's header against the file's size, before any memory is taken; then its checksum.

    Raises
    ------
    InputError
        The file is missing, empty, of an unknown kind, shorter than its header promises, or does not match the checksum
        that a generated scan has.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: '{path.suffix}' is no known kind of scan; give one of {', '.join(SUFFIXES)}")
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: is empty; scan again")
    if path.suffix.lower() == ".ply":
        with path.open("rb") as file:
            start = file.read(65_536).split(b"end_header")[0]
        words = [line.split() for line in start.splitlines()]
        counts = [w[2] for w in words if len(w) == 3 and w[0] == b"element"]
        if not start.startswith(b"ply") or not counts or not all(c.isdigit() for c in counts):
            raise InputError(f"{path}: has no PLY header; export the scan again")
        if (promised := sum(int(c) for c in counts)) > size:
            raise InputError(f"{path}: its header promises {promised} elements but it has {size} bytes; copy it again")
        if b"kinran:crc32" in start:
            check_comment(path)


def _load(path: Path) -> tuple[Any, Any]:
    """The pymeshlab module and a MeshSet that holds the scan."""
    pymeshlab = load_pymeshlab()
    scan = pymeshlab.MeshSet(verbose=False)
    try:
        scan.load_new_mesh(str(path))
    except pymeshlab.PyMeshLabException as error:
        raise InputError(f"{path}: cannot be read as a mesh ({str(error).strip()}); export the scan again") from None
    mesh = scan.current_mesh()
    if mesh.face_number() == 0:
        raise InputError(f"{path}: has {mesh.vertex_number()} vertices but no faces; export a mesh, not points")
    vertices = mesh.vertex_matrix()
    if not np.isfinite(vertices).all():
        raise InputError(f"{path}: has vertices that are not finite; export without missing points")
    if not SMALLEST < (size := float(np.ptp(vertices, axis=0).max())) < LARGEST:
        raise InputError(f"{path}: is {size:.4g} mm long; a panel of cloth is not, scale the scan to millimetres")
    return pymeshlab, scan


def clean(path: Path) -> tuple[Array, Faces, dict[str, Any]]:
    """Turn a raw scan into one manifold sheet.

    The order matters: with one non-manifold vertex left, closing holes does almost nothing and says nothing.

    Parameters
    ----------
    path
        PLY, OBJ, STL or OFF; millimetres.

    Returns
    -------
    vertices : (n, 3) float
        Positions in mm, in the scan's coordinates.
    faces : (m, 3) int
        Counter-clockwise seen from the side that most of the scan's faces show.
    report : dict
        Numbers of components in the scan and of holes that were closed.

    Raises
    ------
    InputError
        The scan cannot be read, has several panels, or is no sheet.
    """
    pymeshlab, scan = _load(path)
    raw_area = vector_area(scan.current_mesh().vertex_matrix(), scan.current_mesh().face_matrix())
    scan.meshing_remove_duplicate_vertices()
    scan.meshing_remove_duplicate_faces()
    scan.meshing_remove_null_faces()
    scan.meshing_remove_folded_faces()
    scan.meshing_remove_unreferenced_vertices()
    scan.meshing_repair_non_manifold_edges(method="Remove Faces")
    scan.meshing_repair_non_manifold_vertices()
    report = {"components": int(scan.get_topological_measures()["connected_components_number"])}
    least = int(ISLAND * scan.current_mesh().face_number())
    scan.meshing_remove_connected_component_by_face_number(mincomponentsize=max(least, 2))
    scan.meshing_re_orient_faces_coherently()
    panels = int(scan.get_topological_measures()["connected_components_number"])
    if panels != 1:
        raise InputError(f"{path}: has {panels} separate panels; give one scan a panel, cut at the seams")

    before = boundary_loops(scan.current_mesh().face_matrix())
    if not before:
        raise InputError(f"{path}: is a closed surface; a panel has an edge, cut the scan at the seams")
    # a hole is less than half as long as the outline: the second end of a tube is none
    scan.meshing_close_holes(maxholesize=max(len(before[0]) // 2, 4), selfintersection=False)
    edge = _edge_length(scan.current_mesh().vertex_matrix(), scan.current_mesh().face_matrix())
    scan.apply_coord_taubin_smoothing(lambda_=0.5, mu=-0.53, stepsmoothnum=20)
    scan.meshing_isotropic_explicit_remeshing(targetlen=pymeshlab.PureValue(edge), iterations=4)
    scan.apply_coord_taubin_smoothing(lambda_=0.5, mu=-0.53, stepsmoothnum=10)

    vertices = np.array(scan.current_mesh().vertex_matrix(), float)
    faces = np.array(scan.current_mesh().face_matrix(), np.int64)
    if vector_area(vertices, faces) @ raw_area < 0:
        faces = faces[:, ::-1].copy()
    report["holes_closed"] = len(before) - len(boundary_loops(faces))
    _check_disc(path, faces)
    return vertices, faces, report


def _edge_length(vertices: Array, faces: Faces) -> float:
    """Edge length in mm that gives `FACES` triangles, but none shorter than the scan's own."""
    area = np.linalg.norm(crosses(vertices, faces), axis=-1).sum() / 2
    own = np.median(np.linalg.norm(vertices[faces[:, 0]] - vertices[faces[:, 1]], axis=-1))
    return float(max(np.sqrt(area / FACES * 4 / np.sqrt(3)), own))


def _check_disc(path: Path, faces: Faces) -> None:
    loops = len(boundary_loops(faces))
    edges = np.unique(np.sort(half_edges(faces), axis=1), axis=0)
    euler = len(np.unique(faces)) - len(edges) + len(faces)
    if loops != 1 or euler != 1:
        raise InputError(
            f"{path}: is no flat sheet with one outline ({loops} outlines, Euler number {euler}); "
            "cut the scan at the seams and close large holes"
        )


def write_mesh(path: Path, vertices: Array, faces: Faces, uv: Array) -> None:
    """Write a binary PLY with normals and one s, t a vertex; Mitsuba reads no wedge coordinates."""
    table = np.hstack([vertices, vertex_normals(vertices, faces), uv]).astype("<f4")
    corners = np.empty(len(faces), [("count", "u1"), ("corners", "<i4", 3)])
    corners["count"], corners["corners"] = 3, faces
    fields = "".join(f"property float {name}\n" for name in ["x", "y", "z", "nx", "ny", "nz", "s", "t"])
    start = b"ply\nformat binary_little_endian 1.0\ncomment kinran: mm; s, t in mm along weft and warp\n"
    header = (
        f"element vertex {len(vertices)}\n{fields}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rest = header.encode("ascii") + table.tobytes() + corners.tobytes()
    with atomic(path) as temporary:
        temporary.write_bytes(start + f"comment {comment(start, rest)}\n".encode() + rest)


def prepare(scan: Path, out: Path, report: Path | None = None) -> dict[str, Any]:
    """Clean and unwrap the scan of one panel.

    Parameters
    ----------
    scan
        Raw scan in mm, whose +y is taken for up.
    out
        PLY to write: the panel hung up (warp along +y, front to +z, middle at the origin), vertex normals
        and s, t in mm from the lower left corner: +s the weft, +t the warp; right-handed seen from the front.
    report
        JSON to write.

    Returns
    -------
    dict
        Values of `report`.

    Raises
    ------
    InputError
        The scan is unreadable, has several panels, is closed, or cannot be flattened without folding over.
    """
    check_scan(scan)
    try:
        spawn, mine = multiprocessing.get_context("spawn"), (os.getpid(),)
        with ProcessPoolExecutor(1, spawn, initializer=end_with_parent, initargs=mine) as pool:
            vertices, faces, counts = pool.submit(clean, scan).result()
    except BrokenProcessPool:
        raise InputError(f"{scan}: pymeshlab died while cleaning it; run kinran doctor") from None
    uv = unwrap(vertices, faces)
    loops = boundary_loops(faces)
    uv, residuals = turn_to_weft(uv, loops[0])
    square = uv.max(0).min() > SQUARE * uv.max()
    turns = [quarter_turns(uv, k) for k in ((0, 1, 2, 3) if square else (0, 2))]
    uv = max(turns, key=lambda turned: hang(vertices, faces, turned)[1, 1])  # what is upright in the scan
    mean, p99, flipped = stretch(vertices, faces, uv)
    if flipped:
        raise InputError(
            f"{scan}: {flipped} of {len(faces)} faces fold over when flattened; "
            "cut the scan where it is not one flat piece of cloth"
        )
    motion = hang(vertices, faces, uv)
    write_mesh(out, vertices @ motion[:3, :3].T + motion[:3, 3], faces, uv)
    values = {
        "vertices": len(vertices),
        "faces": len(faces),
        **counts,
        "boundary_loops": len(loops),
        "size_mm": uv.max(0).tolist(),
        "stretch_mean": mean,
        "stretch_p99": p99,
        "flipped": flipped,
        "weft_from": "upright scan" if square else "sides",
        "weft_residual_degrees": float(np.degrees(np.abs(residuals).max())),
        "scan_to_mesh": motion.tolist(),
    }
    if report:
        write_json(report, values)
    return values
