from pathlib import Path

import numpy as np

from kinran.scene.flatten import boundary_loops
from kinran.virtual.scan import LENGTH, WIDTH, drape, scan, write_scan


def test_the_cloth_keeps_its_lengths_except_under_the_bump() -> None:
    """|∂P/∂u| and |∂P/∂v| are 1 and they are perpendicular, to 1e-3, farther than 4 σ from the bump."""
    rng = np.random.default_rng(0)
    uv = rng.uniform(1, [WIDTH - 1, LENGTH - 1], (4000, 2))
    uv = uv[np.linalg.norm(uv - [WIDTH / 2 - 6, LENGTH / 2 + 8], axis=-1) > 36]
    du, dv = ((drape(uv + step) - drape(uv - step)) / 2e-3 for step in 1e-3 * np.eye(2))
    assert np.abs(np.linalg.norm(du, axis=-1) - 1).max() < 1e-3
    assert np.abs(np.linalg.norm(dv, axis=-1) - 1).max() < 1e-3
    assert np.abs((du * dv).sum(-1)).max() < 1e-3


def test_same_seed_same_scan() -> None:
    first, second, other = scan(1), scan(1), scan(2)
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])
    assert first[0].shape != other[0].shape or not np.array_equal(first[0], other[0])


def test_the_scan_has_the_faults_that_it_promises() -> None:
    _, faces, _ = scan(0)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    assert (counts > 2).sum() >= 10  # fins
    assert len(boundary_loops(faces)) > 50  # holes, islands, loose triangles
    assert (faces[:, 0] == faces[:, 1]).sum() == 6


def test_the_truth_is_where_the_scan_is() -> None:
    """Nine tenths of the samples lie within 0.5 mm of the true surface, sampled every 0.25 mm."""
    from scipy.spatial import cKDTree

    vertices, _, truth = scan(0)
    assert np.quantile(cKDTree(truth.points).query(vertices)[0], 0.9) < 0.5


def test_write_scan_is_ascii_ply(tmp_path: Path) -> None:
    vertices, faces, _ = scan(0)
    write_scan(tmp_path / "scan.ply", vertices, faces)
    lines = (tmp_path / "scan.ply").read_text().splitlines()
    assert lines[0] == "ply"
    assert len(lines) == lines.index("end_header") + 1 + len(vertices) + len(faces)
