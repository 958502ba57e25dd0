"""What runs, and above all what does not run again."""

import json
from pathlib import Path

import pytest
from conftest import Project

from kinran.base.exr import read_exr
from kinran_bsdf import read_material


def downstream(merges: int) -> set[str]:
    """Rules that follow from a change of the radiance."""
    return {"merge", "stack", "segment", "need", "prior", "fit", "material", "sigma", "choose", "evaluate", "scene",
            "render", "report", "overview", "all"} - (set() if merges else {"merge"})  # fmt: skip


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


def test_second_run_does_nothing(finished: Project) -> None:
    assert "Nothing to be done" in finished.run()


def test_one_direction_shot_again(project: Project) -> None:
    """Its group is captured and merged; of that group one bracket is new, and no other file is touched."""
    row = "tiny\t40\t45\t1\tthe thread had moved"
    project.sheet("recapture", "fabric\ttheta\tphi\trevision\treason", row)
    jobs = project.planned()
    assert jobs["capture"] == 1
    assert jobs["merge"] == 1
    assert set(jobs) == downstream(1) | {"capture"}
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


def test_another_holdout_merges_nothing(project: Project) -> None:
    project.configure(lambda config: config.update(holdout=4))
    assert set(project.planned()) == downstream(0)


def test_another_model_fits_nothing_again(project: Project) -> None:
    project.configure(lambda config: config["fit"].update(model="takeda2008", compare=["slope"]))
    assert not {"fit", "prior", "stack", "segment", "merge", "capture"} & set(project.planned())


def test_gold_alone_leaves_the_rest_a_texture(project: Project) -> None:
    project.configure(lambda config: config["fit"].update(regions="shiniest"))
    project.run("results/tiny/scene/scene.xml")
    assert "blendbsdf" in (project.folder / "results" / "tiny" / "scene" / "scene.xml").read_text()


def closer(project: Project) -> None:
    """Bring the scene's camera so near that it looks between the threads."""
    template = project.folder / "small.xml"
    text = template.read_text()
    assert 'name="fov" value="12"' in text
    template.write_text(text.replace('name="fov" value="12"', 'name="fov" value="0.002"'))


def test_another_camera_fits_again_only_what_depends_on_it(project: Project) -> None:
    """Maps are those of the needed regions: with a camera that sees one thread, the other one stays a texture."""
    needs = project.folder / "results" / "tiny" / "need.json"
    assert [row["needed"] for row in json.loads(needs.read_text())["regions"]] == [True, True]
    untouched = {"fit", "prior", "material", "segment", "stack", "merge", "capture"}
    closer(project)
    jobs = set(project.planned())
    assert {"need", "scene", "render", "report"} <= jobs
    assert not untouched & jobs
    project.configure(lambda config: config["fit"].update(regions="needed", compare=[]))
    project.run("results/tiny/scene/scene.xml")
    assert [row["needed"] for row in json.loads(needs.read_text())["regions"]].count(False) == 1
    assert "blendbsdf" in (project.folder / "results" / "tiny" / "scene" / "scene.xml").read_text()
    template = project.folder / "small.xml"
    template.write_text(template.read_text().replace('value="0.002"', 'value="12"'))
    assert {"need", "fit", "material", "scene"} <= set(project.planned())


def test_a_far_camera_gets_coarse_maps(project: Project) -> None:
    """Model no more than a scene needs: texels that its camera cannot tell apart are fitted as one."""
    template = project.folder / "small.xml"
    template.write_text(template.read_text().replace('name="fov" value="12"', 'name="fov" value="20"'))
    project.configure(lambda config: config["fit"].update(texels="needed", compare=[]))
    wanted = "results/tiny/evaluation.json", "results/tiny/scene/scene.xml"
    project.run(*wanted)
    results = project.folder / "results" / "tiny"
    factor = json.loads((results / "need.json").read_text())["footprint"]["coarsest_factor"]
    assert factor > 1
    fine, material = read_exr(results / "labels.exr"), read_material(results / "material.exr")
    assert material.size == tuple(side // factor for side in fine["label"].shape)
    assert "Nothing to be done" in project.run("--dry-run", *wanted)


def test_without_a_rig_nothing_is_ever_captured(project: Project) -> None:
    project.configure(lambda config: config["rig"].update(device="none", exposures=[25, 100]))
    assert "Nothing to be done" in project.run("--dry-run")


def test_a_comment_in_the_config_reruns_nothing(project: Project) -> None:
    config = project.folder / "config.yaml"
    config.write_text("# a note\n" + config.read_text())
    assert "Nothing to be done" in project.run("--dry-run")


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


@pytest.mark.parametrize(
    ("name", "rules"),
    [
        ("render.png", {"render", "report"}),
        ("fit/slope.exr", {"fit", "material", "choose", "evaluate", "sigma", "scene", "render", "report"}),
        ("labels.exr", {"segment", "fit", "material", "need", "evaluate", "report"}),
        ("radiance.zarr/radiance/c/0/0/0/0", {"merge", "stack", "segment", "fit", "material", "report"}),
        ("radiance.zarr/flags/c/4/0/0/0", {"stack", "segment", "fit", "material", "report"}),
        ("radiance.zarr/flags/zarr.json", {"stack", "segment", "report"}),
    ],
)
def test_what_is_gone_is_made_again(project: Project, name: str, rules: set[str]) -> None:
    """Also where no rule asks for it, and where no rule can name it."""
    path = project.folder / "results" / "tiny" / name
    path.unlink()
    jobs = project.planned()
    assert rules <= set(jobs)
    assert ("merge" in jobs) == ("merge" in rules)
    assert jobs.get("merge", 1) == 1  # one group of two
    assert not {"capture", "calibrate"} & set(jobs)


def test_a_lost_shard_is_merged_again_and_no_more_than_once(project: Project) -> None:
    path = project.folder / "results" / "tiny" / "radiance.zarr" / "radiance" / "c" / "0" / "0" / "0" / "0"
    before = path.read_bytes()
    path.unlink()
    stack = "results/tiny/radiance.zarr/zarr.json"
    project.run(stack)
    assert path.read_bytes() == before
    assert "Nothing to be done" in project.run("--dry-run", stack)
