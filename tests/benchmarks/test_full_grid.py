"""The benchmark of the chart: its stack, its command lines, its targets."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import chart, fit
from kinran.base.frames import direction
from kinran.compare import chart as chart_stage
from kinran.compare import rows, trial
from kinran.compare.methods import kinds
from kinran.compare.rows import Row
from kinran.data.fabric import Fabric
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance_stack import Stack
from kinran.virtual.weave import VirtualFabric


def test_the_stack_holds_what_the_camera_saw_and_how_bright_it_can_see(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "FABRIC", VirtualFabric(field_mm=0.4, texels=4))
    poses = np.radians([(0, 0), (40, 0), (40, 90), (80, 355)])
    lights = direction(*poses.T)
    seen = np.random.default_rng(0).uniform(0, 2, (4, 16, 3)).astype(np.float32)
    held = np.array([False, True, False, False])
    scene = fit.Truth(seen, seen, lights, held, np.ones(4), np.ones(16, bool))
    chart.write_stack(scene, tmp_path / "radiance.zarr")
    stack = Stack.open(tmp_path / "radiance.zarr")
    assert [light.grid for light in stack.lights] == [(0, 0), (8, 0), (8, 18), (16, 71)]
    assert stack.texel_mm == pytest.approx(0.1)
    one = np.ones((4, 4), np.float32)
    write_labels(tmp_path / "labels.exr", 0 * one.astype(int), one, 0 * one.astype(int), one)
    write_regions(tmp_path / "regions.json", [Region(0, "gold", 16, (0.5, 0.5, 0.5), 1.0)])
    tried = trial.read(Fabric(tmp_path))
    np.testing.assert_allclose(tried.truth[:, :, 0], seen[1], rtol=1e-3)
    clips = [float(clip[0]) for clip in tried.clips]
    assert clips == sorted(clips)
    assert 17 < clips[-1] < 19  # radiance that fills the well in 1/4096 s
    assert 0.1 < clips[0] < 0.12


def test_all_kinds_of_methods_are_charted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the stage `chart` writes for each kind, joined to one table."""

    def one_row(inputs: chart_stage.Inputs, out: Path, options: chart_stage.Options) -> None:
        assert inputs.fabric == tmp_path
        family = "default" if options.kind == "default" else "kinran"
        values = {"relative_error": 0.1, "microseconds": 1.0, "bytes": 9.0, "psnr_display": 30.0}
        floor = Row(options.name, "floor", "relative_error", "read", "floor", 9, {"microseconds": 0.5})
        rows.write(out, [floor, Row(options.name, "all", "", options.kind, family, 9, values)])

    monkeypatch.setattr(chart_stage, "main", one_row)
    chart.charted(tmp_path)
    found = [row.method for row in rows.read(tmp_path / "chart.csv") if row.experiment == "all"]
    assert sorted(found) == sorted(["default", *kinds()])
    assert all((tmp_path / name).is_file() for name in ("chart.svg", "chart.png", "chart.html"))


def test_targets_are_met_or_missed(tmp_path: Path) -> None:
    table = [
        Row("f", experiment, setting, f"{method} (x)" if method == "default" else method, "kinran", 9, {measure: value})
        for (_, experiment, setting, method, measure, most), value in zip(chart.TARGETS, VALUES, strict=True)
    ]
    merged = [Row(**{**vars(r), "values": {**r.values, **EXTRA}}) for r in table]
    rows.write(tmp_path / "chart.csv", merged)
    found = chart.targets(tmp_path / "chart.csv")
    assert [row["what"] for row in found] == [target[0] for target in chart.TARGETS]
    assert found[0]["met"]
    assert not found[1]["met"]


VALUES = (0.07, 0.07, 0.05, 44, 0.1, 0, 0.3)
EXTRA = {"bytes": 44.0, "texels_above_1": 0.0}
