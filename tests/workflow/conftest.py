"""A tiny virtual fabric, run once through the whole workflow."""

import fcntl
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]

TINY = ROOT / ".test"
"""The working folder of a tiny virtual fabric, which users may run, too."""


def small_template() -> str:
    """The project's scene with a picture small enough for a test."""
    return (TINY / "small.xml").read_text()


class Project:
    """A working folder with a config and sheets of its own, run by the project's Snakefile."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "config").mkdir(parents=True)
        for name in ("small.xml", "config.yaml", "config/fabrics.tsv", "config/recapture.tsv"):
            shutil.copyfile(TINY / name, folder / name)

    @classmethod
    def of(cls, folder: Path) -> "Project":
        """The project in a folder that is there, or will be."""
        project = object.__new__(cls)
        project.folder = folder
        return project

    def configure(self, change: Callable[[dict], object]) -> None:
        config = yaml.safe_load((TINY / "config.yaml").read_text())
        change(config)
        (self.folder / "config.yaml").write_text(yaml.safe_dump(config))

    def sheet(self, name: str, *rows: str) -> None:
        (self.folder / "config" / f"{name}.tsv").write_text("\n".join(rows) + "\n")

    def snakemake(self, *options: str, snakefile: Path = ROOT / "Snakefile") -> "subprocess.CompletedProcess[str]":
        command = [sys.executable, "-m", "snakemake", "-s", str(snakefile), "-d", str(self.folder), "-c2"]
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
    """The tiny fabric after a full run, one for all processes of a test run; tests that change it take a copy."""
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    folder = base / "finished"
    with (base / "finished.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            project = Project(base / "unfinished")
            project.run()
            project.folder.rename(folder)
    return Project.of(folder)


@pytest.fixture
def project(finished: Project, tmp_path: Path) -> Project:
    """A copy of the finished run, times and bookkeeping included."""
    folder = tmp_path / "copy"
    shutil.copytree(finished.folder, folder, symlinks=True)
    return Project.of(folder)
