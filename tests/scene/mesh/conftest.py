from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from kinran.scene.mesh import prepare
from kinran.virtual.scan import Truth, scan, write_scan


class Panel(NamedTuple):
    """A generated scan after the stage, and its truth moved into the mesh's coordinates."""

    path: Path
    report: dict[str, Any]
    truth: Truth


@pytest.fixture(scope="session")
def panel(tmp_path_factory: pytest.TempPathFactory) -> Panel:
    folder = tmp_path_factory.mktemp("panel")
    vertices, faces, truth = scan(seed=3)
    write_scan(folder / "scan.ply", vertices, faces)
    report = prepare(folder / "scan.ply", folder / "mesh.ply", folder / "mesh.json")
    motion = np.array(report["scan_to_mesh"])
    moved = replace(truth, points=truth.points @ motion[:3, :3].T + motion[:3, 3], weft=truth.weft @ motion[:3, :3].T)
    return Panel(folder / "mesh.ply", report, moved)
