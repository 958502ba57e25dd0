"""Many fabrics: each with settings of its own, and none that falls with another."""

import re
import shutil
import sys
from pathlib import Path

import pytest
import yaml
from conftest import ROOT, Project

sys.path.insert(0, str(ROOT / "tests" / "slurm"))
from on_slurm import photographs

HEADER = "fabric\tsource\tencoding\tcrop\tregions\tseeds"
TINY, OTHER = "tiny\trig\t\t\t2\t", "other\trig\t\t\t2\t"


def own(project: Project, fabric: str, settings: dict) -> None:
    """Give a fabric settings of its own."""
    path = project.folder / "config" / "fabrics" / f"{fabric}.yaml"
    path.parent.mkdir(exist_ok=True)
    path.write_text(yaml.safe_dump(settings))


def fabrics(project: Project) -> dict[str, set[str]]:
    """Rules of the jobs that a run would do now, by the fabric that they are of."""
    found: dict[str, set[str]] = {}
    for part in re.split(r"^(?:local)?rule ", project.run("--dry-run"), flags=re.MULTILINE)[1:]:
        if of := re.search(r"^ +wildcards: .*\bfabric=(\w+)", part, re.MULTILINE):
            found.setdefault(of[1], set()).add(part.split(":")[0])
    return found


def test_one_fabric_s_settings_touch_no_other(project: Project) -> None:
    project.sheet("fabrics", HEADER, TINY, OTHER)
    own(project, "other", {"rig": {"exposures": [10, 1000]}, "virtual": {"seed": 8}, "fit": {"model": "lambert"}})
    # the same as before, from another file; what else a fabric's settings rerun is in test_reruns.py
    own(project, "tiny", {"rig": {"exposures": [25, 100, 250, 1000, 4000]}, "holdout": 8})
    assert set(fabrics(project)) == {"other"}


def test_what_a_fabric_has_of_its_own_reaches_its_commands_alone(tmp_path: Path) -> None:
    project = Project(tmp_path / "project")
    project.sheet("fabrics", HEADER, TINY, OTHER)
    (project.folder / "close.xml").write_text((project.folder / "small.xml").read_text())
    (project.folder / "cloth.ply").touch()
    settings = {
        "holdout": 4,
        "rig": {"phis": 16, "exposures": [10], "camera_mm": 500, "lamp": "xenon"},
        "virtual": {"motif": "waves", "seed": 11},
        "fit": {"model": "takeda2008", "compare": ["lambert"], "jobs": 3, "texels": "needed", "regions": "shiniest"},
        "scene": {"template": "close.xml", "scan": "cloth.ply"},
    }
    own(project, "other", settings)
    commands = [line for line in project.run("--dry-run", "--printshellcmds").splitlines() if "-m kinran" in line]
    mine, others = ("\n".join(line for line in commands if name in line) for name in ("tiny", "other"))
    for text in (
        *("--phis 16", "--exposures 0.1 ", "--camera-mm 500", "--lamp=xenon", '"motif": "waves"', '"seed": 11'),
        *("--holdout 4", "--tile 2/3", "--model lambert", "--fabric results/other/needed", "--fitted 0"),
        *("--template close.xml", "--mesh results/other/scene/mesh.ply"),
    ):
        assert text in others, text
        assert text not in mine, text
    assert "--model slope" in mine
    assert "--model slope" not in others


def test_a_scan_is_cleaned_once_for_all_fabrics_that_have_it(project: Project) -> None:
    """Also by another path to the same file, and for a fabric that comes later; a scan that was replaced, again."""
    scan = project.folder / "cloth.ply"
    shutil.copy(project.folder / "results" / "tiny" / "scan.ply", scan)
    project.sheet("fabrics", HEADER, TINY, OTHER)
    own(project, "tiny", {"scene": {"scan": "cloth.ply"}})
    own(project, "other", {"scene": {"scan": "./cloth.ply"}})
    meshes = [f"results/{name}/scene/mesh.ply" for name in ("tiny", "other")]
    said = project.run(*meshes)
    assert [said.count(f"rule {name}:") for name in ("scan", "mesh", "own_mesh")] == [1, 1, 2]
    assert len({(project.folder / mesh).read_bytes() for mesh in meshes}) == 1
    project.sheet("fabrics", HEADER, TINY, OTHER, "later\trig\t\t\t2\t")
    own(project, "later", {"scene": {"scan": "cloth.ply"}})
    assert not {"scan", "mesh"} & set(project.planned())
    scan.write_bytes(scan.read_bytes().replace(b"comment", b"COMMENT", 1) + b" ")
    jobs = project.planned()
    assert (jobs["scan"], jobs["mesh"], jobs["own_mesh"]) == (1, 1, 3)


def test_bad_fabrics_stop_no_other(project: Project) -> None:
    """One with a wrong row, and one whose photograph is broken: the overview lists both until they are cured."""
    folder, page = project.folder, project.folder / "results" / "report.html"
    photographs(folder / "set")
    (folder / "set" / "p05.png").write_bytes(b"no picture")
    (folder / "results" / "tiny" / "render.png").unlink()  # tiny has something to do
    project.sheet("fabrics", HEADER, TINY, "torn\tset\t\t\t2\t", "wrong\trig\t\t\tmany\t", "gone\tnowhere\t\t\t\t")
    done = project.snakemake("--quiet", "rules")
    assert done.returncode != 0
    assert "left out: config/fabrics.tsv: line 4: fabric 'wrong': regions: 'many' does not match" in done.stderr
    assert (folder / "results" / "tiny" / "render.png").is_file()
    rows = re.findall(r"<tr><td>(.*?)</td><td>(.*?)</td><td>(.*?)</td><td><a href=\"\.\./(.*?)\"", page.read_text())
    said = {fabric: (stage, says, log) for fabric, stage, says, log in rows}
    assert set(said) == {"torn", "wrong", "gone"}
    assert (said["torn"][0], said["torn"][2]) == ("ingest", "logs/torn/ingest.log")
    assert "set/p05.png: is not an image that can be read" in said["torn"][1]
    assert said["wrong"][0] == "config"
    assert "nowhere: no such folder" in said["gone"][1]
    assert all((folder / log).read_text().strip() for _, _, log in said.values())
    assert "tiny/report.html" in page.read_text()
    project.sheet("fabrics", HEADER, TINY)
    project.run()
    assert "Not finished" not in page.read_text()
    assert "tiny/report.html" in page.read_text()
    assert "Nothing to be done" in project.run()


@pytest.mark.parametrize("only", ["wrong\trig\t\t\tmany\t", "wrong\tnowhere\t\t\t\t"])
def test_a_run_without_a_sound_fabric_fails_and_says_so(tmp_path: Path, only: str) -> None:
    project = Project(tmp_path / "project")
    project.sheet("fabrics", HEADER, only)
    assert project.snakemake().returncode != 0
    assert "<td>wrong</td><td>config</td>" in (project.folder / "results" / "report.html").read_text()
