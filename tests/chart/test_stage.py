"""The stage `kinran chart` from files to files."""

from pathlib import Path

import numpy as np
import pytest
from trials import SHAPE, shiny_trial

from kinran.__main__ import main
from kinran.chart import methods, rows, stage
from kinran.files import write_json
from kinran.labels import Region, write_labels, write_regions
from kinran.radiance.value import Radiance
from kinran.stack import Light, Metadata, write_metadata, write_shards
from kinran_bsdf.material import Material, write_material


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A stack, labels, regions and a Lambertian material of the small trial."""
    tried = shiny_trial()
    samples = np.concatenate([tried.T, tried.truth], 2)
    directions = np.concatenate([tried.lights, tried.held_out])
    radiance = samples.transpose(2, 0, 1).reshape(len(directions), *SHAPE, 3)
    named = enumerate(directions.tolist())
    lights = tuple(Light(f"l{k}", tuple(d), held_out=k >= len(tried.lights)) for k, d in named)
    stack = tmp_path / "radiance.zarr"
    write_shards(stack, 0, Radiance.unflagged(radiance))
    write_metadata(stack, Metadata(lights, *SHAPE, None, "", "", "camera", np.eye(3), {"kind": "photograph"}))
    labels = tried.region.reshape(SHAPE)
    one = np.ones(SHAPE, np.float32)
    write_labels(tmp_path / "labels.exr", labels, one, labels, one)
    regions = [Region(k, name, 54, (0.5, 0.5, 0.5), 1.0) for k, name in enumerate(("gold", "red"))]
    write_regions(tmp_path / "regions.json", regions)
    channels = dict.fromkeys(("diffuse.R", "diffuse.G", "diffuse.B", "bound"), one)
    channels |= {"label": labels.astype(np.float32), "diffuse.amplitude": one / 9, "diffuse.x": 0 * one}
    channels |= {"diffuse.y": 0 * one}
    names = [{"label": r.label, "name": r.name, "model": "lambert"} for r in regions]
    material = Material(
        channels, "lambert", "ggx", 0, names, "lin_ap1_scene", np.eye(3), None, "0" * 64, float(np.radians(70))
    )
    write_material(tmp_path / "material.exr", material)
    write_json(tmp_path / "fit.json", {"model": "lambert", "microseconds_per_texel": 6.7, "bytes_per_texel": 12})
    return tmp_path


def arguments(folder: Path) -> list[str]:
    given = {
        "--fabric": "cloth",
        "--stack": folder / "radiance.zarr",
        "--labels": folder / "labels.exr",
        "--regions": folder / "regions.json",
        "--material": folder / "material.exr",
        "--summary": folder / "fit.json",
    }
    return ["chart", str(folder / "chart.csv"), *(str(part) for pair in given.items() for part in pair)]


def test_from_files_to_files(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    cheap = [m for m in methods.methods() if m.name in ("Lambert", "PTM", "Delaunay")]
    monkeypatch.setattr(stage, "methods", lambda: cheap)
    pictures = ["--pictures", str(folder / "chart.svg"), str(folder / "chart.png")]
    assert main([*arguments(folder), *pictures]) == 0
    table = {row.method: row for row in rows.read(folder / "chart.csv") if row.experiment == "all"}
    assert set(table) == {"default (lambert)", "Lambert", "PTM", "Delaunay"}
    default = table["default (lambert)"]
    assert default["microseconds"] == 6.7
    assert default["relative_error"] > table["Lambert"]["relative_error"]
    assert (folder / "chart.svg").read_text().startswith("<svg")
    assert (folder / "chart.png").read_bytes()[:4] == b"\x89PNG"
    assert "default (lambert): relative error" in capsys.readouterr().err
    assert main(["charts", str(folder / "chart.html"), "--charts", str(folder / "chart.csv")]) == 0
    assert "default (lambert)" in (folder / "chart.html").read_text()


def test_a_material_of_another_size(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stack = folder / "other.zarr"
    lights = tuple(Light(f"l{k}", (0.1 * k, 0.0, (1 - 0.01 * k * k) ** 0.5), held_out=k == 2) for k in range(8))
    write_shards(stack, 0, Radiance.unflagged(np.ones((8, 20, 20, 3), np.float32)))
    write_metadata(stack, Metadata(lights, 20, 20, None, "", "", "camera", np.eye(3), {"kind": "photograph"}))
    labels = np.zeros((20, 20), np.intp)
    one = np.ones((20, 20), np.float32)
    write_labels(folder / "labels.exr", labels, one, labels, one)
    assert main([a.replace("radiance.zarr", "other.zarr") for a in arguments(folder)]) == 2
    assert "fit it again" in capsys.readouterr().err
    assert not (folder / "chart.csv").exists()


def test_a_kind_at_a_time_joins_to_the_whole(folder: Path) -> None:
    """The jobs of the workflow: each kind of method alone, the default alone, then one table."""
    common = arguments(folder)[2:10]
    assert main(["chart", str(folder / "linear.csv"), *common, "--kind", "linear"]) == 0
    assert {row.family for row in rows.read(folder / "linear.csv")} == {"floor", "baseline"}
    parts = arguments(folder)
    parts[1] = str(folder / "default.csv")
    assert main([*parts, "--kind", "default"]) == 0
    tables = [str(folder / "linear.csv"), str(folder / "default.csv")]
    assert main(["chart-table", str(folder / "whole.csv"), "--tables", *tables]) == 0
    whole = [row for row in rows.read(folder / "whole.csv") if row.experiment in ("floor", "all")]
    assert [row.method for row in whole][:3] == ["read the samples once", "default (lambert)", "Lambert"]
    assert main(["chart", str(folder / "all.csv"), *common]) == 2


def test_the_default_is_its_file_under_all_lights_and_its_model_with_fewer(folder: Path) -> None:
    """The material of the folder is too dark, so its own error is large; its model, fitted again, is Lambert's."""
    parts = arguments(folder)
    parts[1] = str(folder / "default.csv")
    assert main([*parts, "--kind", "default"]) == 0
    assert main(["chart", str(folder / "linear.csv"), *arguments(folder)[2:10], "--kind", "linear"]) == 0
    (lambert,) = [r for r in rows.read(folder / "linear.csv") if (r.experiment, r.method) == ("all", "Lambert")]
    found = {(r.experiment, r.setting): r["relative_error"] for r in rows.read(folder / "default.csv")}
    assert found["all", ""] > 1.1 * lambert["relative_error"]
    assert found["directions", str(lambert.lights)] == pytest.approx(lambert["relative_error"], rel=1e-5)
