"""The stage `kinran chart` from files to files."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trials import SHAPE, shiny_trial

from kinran.__main__ import main
from kinran.base import distances
from kinran.base.files import InputError, read_json, write_json
from kinran.compare import chart, chart_table, rows, trial
from kinran.compare.methods import linear
from kinran.compare.rows import Row
from kinran.data.fabric import Fabric
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.data.texel_directions import Under
from kinran.fit import lambert
from kinran.fit.samples import Samples
from kinran.judge import evaluate
from kinran_bsdf.material import Material, write_material


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A stack, labels, regions and a Lambertian material of the small trial."""
    tried = shiny_trial()
    samples = np.concatenate([tried.samples.T, tried.truth], 2)
    directions = np.concatenate([tried.samples.under.directions, tried.held.directions])
    radiance = samples.transpose(2, 0, 1).reshape(len(directions), *SHAPE, 3)
    named = enumerate(directions.tolist())
    lights = tuple(Light(f"l{k}", tuple(d), held_out=k >= len(tried.lights)) for k, d in named)
    stack = tmp_path / "radiance.zarr"
    write_shards(stack, 0, Radiance.unflagged(radiance))
    write_metadata(stack, Metadata(lights, *SHAPE, None, "", "", "camera", np.eye(3), {"kind": "photograph"}))
    labels = tried.samples.region.reshape(SHAPE)
    one = np.ones(SHAPE, np.float32)
    write_labels(tmp_path / "labels.exr", labels, one, labels, one)
    regions = [Region(k, name, 54, (0.5, 0.5, 0.5), 1.0) for k, name in enumerate(("gold", "red"))]
    write_regions(tmp_path / "regions.json", regions)
    write_material(tmp_path / "material.exr", lambertian(labels, regions))
    write_json(tmp_path / "fit.json", {"model": "lambert", "microseconds_per_texel": 6.7, "bytes_per_texel": 12})
    return tmp_path


def lambertian(labels: np.ndarray, regions: list[Region], texel_mm: float | None = None) -> Material:
    """A Lambertian material, too dark."""
    one = np.ones(labels.shape, np.float32)
    channels = dict.fromkeys(("diffuse.R", "diffuse.G", "diffuse.B", "bound"), one)
    channels |= {"label": labels.astype(np.float32), "diffuse.amplitude": one / 9, "diffuse.x": 0 * one}
    channels |= {"diffuse.y": 0 * one}
    names = [{"label": r.label, "name": r.name, "model": "lambert"} for r in regions]
    seen = float(np.radians(70))
    return Material(channels, "lambert", "ggx", 0, names, "lin_ap1_scene", np.eye(3), texel_mm, "0" * 64, seen)


def charted(folder: Path, kind: str) -> list[Row]:
    """Rows of a kind of method."""
    inputs = chart.Inputs(folder, folder / "material.exr", folder / "fit.json")
    chart.main(inputs, folder / f"{kind}.csv", chart.Options("cloth", kind))
    return rows.read(folder / f"{kind}.csv")


def test_a_kind_at_a_time_joins_to_the_whole(
    folder: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The jobs of the workflow: each kind of method alone, the default alone, then one table and its pictures."""
    caplog.set_level(logging.INFO, "kinran")
    monkeypatch.setattr(linear, "METHODS", linear.METHODS[:2])
    assert {row.family for row in charted(folder, "linear")} == {"floor", "baseline"}
    parts = [*charted(folder, "linear"), *charted(folder, "default")]
    pictures = [folder / "chart.svg", folder / "chart.png"]
    chart_table.write(folder / "chart.csv", parts, pictures)
    whole = [row for row in rows.read(folder / "chart.csv") if row.experiment in ("floor", "all")]
    assert [row.method for row in whole] == ["read the samples once", "default (lambert)", "Lambert", "PTM"]
    default, plain = whole[1:3]
    assert default["microseconds"] == 6.7
    assert default["relative_error"] > plain["relative_error"]
    assert (folder / "chart.svg").read_text().startswith("<svg")
    assert (folder / "chart.png").read_bytes()[:4] == b"\x89PNG"
    assert "default (lambert): relative error" in caplog.text
    assert main(["chart-page", str(folder / "chart.html"), "--charts", str(folder / "chart.csv")]) == 0
    assert "default (lambert)" in (folder / "chart.html").read_text()


def test_the_command_line(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    common = ["chart", str(folder / "default.csv"), "--fabric", str(folder), "--name", "cloth"]
    files = ["--material", str(folder / "material.exr"), "--summary", str(folder / "fit.json")]
    assert main([*common, *files, "--kind", "default"]) == 0
    assert main([*common, "--kind", "default"]) == 2
    assert "needs --material and --summary" in capsys.readouterr().err
    assert main([*common, "--kind", "splines"]) == 2
    assert "splines: is none of cosine_lobes, " in capsys.readouterr().err


def test_a_material_of_another_size(folder: Path) -> None:
    regions = Fabric(folder).regions
    write_material(folder / "material.exr", lambertian(np.zeros((20, 20), np.intp), regions))
    with pytest.raises(InputError, match="fit it again"):
        charted(folder, "default")
    assert not (folder / "default.csv").exists()


def test_the_default_is_its_file_under_all_lights_and_its_model_with_fewer(folder: Path) -> None:
    """The material of the folder is too dark, so its own error is large; its model, fitted again, is Lambert's."""
    (plain,) = [r for r in charted(folder, "linear") if (r.experiment, r.method) == ("all", "Lambert")]
    found = {(r.experiment, r.setting): r["relative_error"] for r in charted(folder, "default")}
    assert found["all", ""] > 1.1 * plain["relative_error"]
    assert found["directions", str(plain.lights)] == pytest.approx(plain["relative_error"], rel=1e-5)


LAMP_MM, FIELD_MM = 120.0, 24.0


@pytest.fixture
def near_fabric(folder: Path) -> Path:
    """A Lambertian sheet of 24 mm under lamps at 120 mm."""
    stack = Fabric(folder).stack
    lights = [replace(light, position_mm=tuple(LAMP_MM * np.array(light.direction))) for light in stack.lights]
    texel_mm = FIELD_MM / SHAPE[1]
    points = distances.texel_points(*SHAPE, texel_mm)
    positions = [np.array(light.position_mm) for light in lights]
    cosine = np.stack([distances.directions_to(position, points)[..., 2] for position in positions])
    seen = 0.3 * (cosine * distances.falloff(positions, points))[..., None].repeat(3, -1)
    write_shards(stack.path, 0, Radiance.unflagged(seen.astype(np.float32)))
    metadata = Metadata(tuple(lights), *SHAPE, texel_mm, "", "", "camera", np.eye(3), {"kind": "photograph"})
    write_metadata(stack.path, metadata)
    near = Fabric(folder)
    write_material(folder / "material.exr", lambertian(near.labels, near.regions, texel_mm))
    return folder


def test_the_chart_and_the_evaluation_say_one_number_for_one_material(near_fabric: Path) -> None:
    out = evaluate.Outputs(near_fabric / "evaluation.json", near_fabric / "evaluation.png")
    write_json(near_fabric / "material.json", {})
    inputs = evaluate.Inputs(near_fabric, (near_fabric / "material.exr",))
    evaluate.main(inputs, out, evaluate.Options("cloth"))
    judged = read_json(out.errors)["methods"]["material"]
    found = {(r.experiment, r.setting): r for r in charted(near_fabric, "default")}
    for measure in ("relative_error", "texel_median", "texel_p95"):
        assert found["all", ""][measure] == pytest.approx(judged[measure], abs=1e-5)
    for region, errors in judged["regions"].items():
        assert found["region", region]["relative_error"] == pytest.approx(errors["relative_error"], abs=1e-5)


def test_methods_see_each_texel_under_its_own_lights(near_fabric: Path) -> None:
    """A Lambertian sheet is one to the chart, too; lamps that are taken for far away leave 3 %."""
    (row,) = [r for r in charted(near_fabric, "linear") if (r.experiment, r.method) == ("all", "Lambert")]
    assert row["relative_error"] < 0.0005
    tried = trial.read(Fabric(near_fabric))
    assert len(tried.held.lights) == len(tried.samples.under.lights) > 1
    measured, W = tried.samples.under.reaching(tried.samples.T), tried.samples.W
    far = lambert.fit(Samples.far(measured, W, tried.samples.under.directions))
    left = far.predict(Under.far(tried.held.directions, tried.texels)) - tried.truth
    assert np.linalg.norm(left) > 0.025 * np.linalg.norm(tried.truth)
