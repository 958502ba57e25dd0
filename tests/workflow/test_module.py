"""The workflow as a module of another one, in a folder of its own and with rules of other names."""

import re
from pathlib import Path

import pytest
from conftest import ROOT, Project

SNAKEFILE = f"""
import yaml

module kinran:
    snakefile: "{ROOT}/Snakefile"
    config: yaml.safe_load(open("config.yaml"))
    prefix: "textiles"

use rule * from kinran as kinran_*

onerror:
    kinran.onerror()
"""


@pytest.fixture
def snakefile(tmp_path: Path) -> Path:
    path = tmp_path / "elsewhere" / "Snakefile"
    path.parent.mkdir()
    path.write_text(SNAKEFILE)
    return path


def test_all_that_is_made_lies_under_the_prefix_and_what_users_name_lies_where_they_say(
    tmp_path: Path, snakefile: Path
) -> None:
    project = Project(tmp_path / "project")
    project.configure(
        lambda config: (
            config["rig"].update(plan="sheet.tsv"),
            config["fit"].update(texels="needed", regions="needed", lobes="choose", residual="all"),
            config["scene"].update(scan="cloth.ply"),
        )
    )
    directions = [f"{theta}\t{phi}" for theta in (10, 20, 40, 60) for phi in range(0, 360, 20)]
    (project.folder / "sheet.tsv").write_text("\n".join(["theta\tphi", *directions]) + "\n")
    (project.folder / "cloth.ply").touch()
    (project.folder / "set").mkdir()
    rows = [f"p{k}.png 0.{k} 0 0.9" for k in range(12)]
    (project.folder / "set" / "a.lp").write_text("\n".join(["12", *rows]) + "\n")
    (project.folder / "set" / "chart.png").touch()
    header = "fabric\tsource\tencoding\tcrop\tregions\tseeds\tchart"
    project.sheet("fabrics", header, "tiny\trig\t\t\t2\t\t", "dome\tset\t\t\t\t\tchart.png")
    done = project.snakemake("--dry-run", "--printshellcmds", "kinran_all", "kinran_chart", snakefile=snakefile)
    assert done.returncode == 0, done.stdout + done.stderr
    commands = [line for line in done.stdout.splitlines() if "python -m kinran" in line or "Shell command: cp " in line]
    assert len({word for line in commands for word in re.findall(r"-m kinran (\S+)", line)}) == 28
    for line in commands:
        assert re.search(r"(?<!textiles/)\b(results|captures|logs)/", line) is None, line
    text = "\n".join(commands)
    for named in ("--template small.xml", "cp cloth.ply ", "--directions sheet.tsv", "--chart set/chart.png"):
        assert named in text
    for derived in (
        "results/tiny/radiance.zarr",
        "results/tiny/needed",
        "results/tiny/need.json",
        "results/tiny/fit/choice.json",
    ):
        assert f"textiles/{derived}" in text


def test_the_overview_lists_who_failed(tmp_path: Path, snakefile: Path) -> None:
    project = Project(tmp_path / "project")
    project.sheet("fabrics", "fabric\tsource\tencoding\tcrop\tregions\tseeds", "wrong\trig\t\t\tmany\t")
    assert project.snakemake(snakefile=snakefile).returncode != 0
    assert "<td>wrong</td><td>config</td>" in (project.folder / "textiles" / "results" / "report.html").read_text()
    assert {path.name for path in project.folder.iterdir()} == {
        *("config", "config.yaml", "small.xml"),
        "textiles",
        ".snakemake",
    }
