"""Whole runs: what they leave, and what is made again as it was; which jobs run when, test_reruns.py says."""

import json
from pathlib import Path

from conftest import Project


def test_full_run_leaves_what_users_look_for(finished: Project) -> None:
    results = finished.folder / "results"
    for name in ("material.exr", "evaluation.json", "report.html", "render.exr", "render.png", "scene/scene.xml"):
        assert (results / "tiny" / name).stat().st_size > 0
    assert "tiny/report.html" in (results / "report.html").read_text()
    errors = json.loads((results / "tiny" / "evaluation.json").read_text())
    assert set(errors["methods"]) == {"slope", "takeda2008"}
    assert len(errors["held_out"]) == 4
    assert 0 < errors["methods"]["slope"]["relative_error"] < errors["methods"]["takeda2008"]["relative_error"]
    assert set(errors["methods"]["slope"]["lights"]) == set(errors["held_out"])


def test_one_direction_shot_again(project: Project) -> None:
    """Of its group one bracket is new, and no other manifest is touched."""
    row = "tiny\t40\t45\t1\tthe thread had moved"
    project.sheet("recapture", "fabric\ttheta\tphi\trevision\treason", row)
    groups = project.folder / "captures" / "tiny" / "groups"
    before = {path.name: path.read_bytes() for path in groups.iterdir()}
    project.run("--until", "merge")
    after = {path.name: path.read_bytes() for path in groups.iterdir()}
    assert [name for name in before if before[name] != after[name]] == ["00.json"]
    old, new = (json.loads(files["00.json"])["shots"] for files in (before, after))
    changed = [b for a, b in zip(old, new, strict=True) if a != b]
    assert [(shot["shot"], shot["revision"]) for shot in changed] == [("t40_p045", 1)]
    frames = project.folder / "captures" / "tiny"
    assert all((frames / frame["file"]).is_file() for shot in old + new for frame in shot["frames"])


def test_what_no_scene_shows_stays_a_texture(project: Project) -> None:
    """With a camera that sees one thread, the other one is not fitted."""
    template, results = project.folder / "small.xml", project.folder / "results" / "tiny"
    text = template.read_text()
    assert 'name="fov" value="12"' in text
    template.write_text(text.replace('name="fov" value="12"', 'name="fov" value="0.002"'))
    project.configure(lambda config: config["fit"].update(regions="needed", compare=[]))
    project.run("results/tiny/scene/scene.xml")
    need = json.loads((results / "fit" / "need.json").read_text())
    assert [row["needed"] for row in need["regions"]].count(False) == 1
    assert "blendbsdf" in (results / "scene" / "scene.xml").read_text()


def test_a_job_that_was_killed_is_done_again(project: Project) -> None:
    """An output that is gone, as Snakemake leaves it after a kill, is made again, byte for byte."""
    material = project.folder / "results" / "tiny" / "fit" / "slope.exr"
    before = material.read_bytes()
    material.unlink()
    project.run("results/tiny/fit/slope.exr")
    assert material.read_bytes() == before


def test_what_the_config_says_reaches_the_commands(tmp_path: Path) -> None:
    """Distances and chart of the rig, and those of a set of photographs."""
    project = Project(tmp_path / "project")
    chart = {"camera_mm": 500, "lamp": "xenon", "chart_corners": "-1,0,9,0,9,6,0,6"}
    project.configure(lambda config: config["rig"].update(chart))
    (project.folder / "set").mkdir()
    rows = [f"p{k}.png 0.{k} 0 0.9" for k in range(12)]
    (project.folder / "set" / "a.lp").write_text("\n".join(["12", *rows]) + "\n")
    header = "fabric\tsource\tencoding\tcrop\tregions\tseeds\tlamp_mm\tfield_mm\tcamera_mm"
    project.sheet("fabrics", header, "tiny\trig\t\t\t2\t\t\t\t", "dome\tset\t\t\t\t\t300\t60\t500")
    text = project.run("--dry-run", "--printshellcmds", "results/tiny/calibration.json", "captures/dome/plan.json")
    assert "--lamp-mm 600 --field-mm 4.8 --camera-mm 500 captures/tiny/plan.json" in text
    assert "--chart-corners=-1,0,9,0,9,6,0,6 --lamp=xenon" in text
    assert "--lamp-mm 300 --field-mm 60 --camera-mm 500 captures/dome/plan.json" in text


def test_what_is_wrong_is_said_before_anything_runs(tmp_path: Path) -> None:
    project = Project(tmp_path / "project")
    project.configure(lambda config: config.update(fitt=1))
    done = project.snakemake("--dry-run")
    assert done.returncode != 0
    assert "'fitt' was unexpected" in done.stderr + done.stdout
    assert not (project.folder / "results").exists()
    project.configure(lambda config: None)
    header = (project.folder / "config" / "recapture.tsv").read_text().splitlines()[0]
    project.sheet("recapture", header, "tiny\t40\t44\t1\tx")
    assert "is no direction of the grid" in project.snakemake("--dry-run").stderr
    assert set(project.planned()) == {"left_out", "overview", "all"}


def test_a_lost_shard_is_merged_again_and_no_more_than_once(project: Project) -> None:
    path = project.folder / "results" / "tiny" / "radiance.zarr" / "radiance" / "c" / "0" / "0" / "0" / "0"
    before = path.read_bytes()
    path.unlink()
    stack = "results/tiny/radiance.zarr/zarr.json"
    project.run(stack)
    assert path.read_bytes() == before
    assert "Nothing to be done" in project.run("--dry-run", stack)
