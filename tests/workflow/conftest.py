"""A tiny virtual fabric, run once through the whole workflow."""

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]

CONFIG = {
    "fabrics": "config/fabrics.tsv",
    "recapture": "config/recapture.tsv",
    "holdout": 8,
    "rig": {
        "device": "virtual",
        "thetas": [0, 20, 40, 60, 80],
        "phis": 8,
        "exposures": [25, 100, 250, 1000, 4000],
        "meridians": 4,
        "lamp_mm": 600,
        "field_mm": 4.8,
    },
    "virtual": {"texels": 24, "samples": 4, "seed": 7},
    "fit": {"model": "slope", "compare": ["takeda2008"], "regions": "all", "jobs": 1},
    "scene": {"template": "small.xml", "scan": "generated"},
}


def small_template() -> str:
    """The project's scene with a picture small enough for a test."""
    template = (ROOT / "scenes" / "drape.xml").read_text()
    for name, value in {"width": "64", "height": "48", "spp": "2"}.items():
        template = re.sub(rf'(<default name="{name}" value=)"[0-9]+"', rf'\1"{value}"', template)
    return template


class Project:
    """A working folder with a config and sheets of its own, run by the project's Snakefile."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "config").mkdir(parents=True)
        (folder / "small.xml").write_text(small_template())
        self.configure(lambda config: None)
        self.sheet("fabrics", "fabric\tsource\tencoding\tcrop\tregions\tseeds", "tiny\trig\t\t\t2\t")
        self.sheet("recapture", "fabric\ttheta\tphi\trevision\treason")

    @classmethod
    def of(cls, folder: Path) -> "Project":
        """The project in a folder that is there, or will be."""
        project = object.__new__(cls)
        project.folder = folder
        return project

    def configure(self, change: Callable[[dict], object]) -> None:
        config = yaml.safe_load(yaml.safe_dump(CONFIG))
        change(config)
        (self.folder / "config.yaml").write_text(yaml.safe_dump(config))

    def sheet(self, name: str, *rows: str) -> None:
        (self.folder / "config" / f"{name}.tsv").write_text("\n".join(rows) + "\n")

    def snakemake(self, *options: str) -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(self.folder), "-c2"]
        return subprocess.run([*command, *options], capture_output=True, text=True, check=False)

    def run(self, *options: str) -> str:
        done = self.snakemake(*options)
        assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-6000:]
        return done.stdout + done.stderr

    def planned(self) -> dict[str, int]:
        """Number of jobs of each rule that a run would do now."""
        text = self.run("--dry-run", "--quiet", "rules")
        jobs = dict(re.findall(r"^(\w+) +(\d+)$", text, re.MULTILINE))
        return {rule: int(count) for rule, count in jobs.items() if rule != "total"}


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Project:
    """The tiny fabric after a full run; tests that change it take a copy."""
    project = Project(tmp_path_factory.mktemp("project"))
    project.run()
    return project


@pytest.fixture
def project(finished: Project, tmp_path: Path) -> Project:
    """A copy of the finished run, times and bookkeeping included."""
    folder = tmp_path / "copy"
    shutil.copytree(finished.folder, folder, symlinks=True)
    return Project.of(folder)
