"""The recipes of an image: they name files that exist, the system libraries of ./kinran, and pinned packages alone."""

import re
import subprocess

import pytest

from kinran.base.probes import LIBRARIES
from kinran.base.project import ROOT

CONTAINER = ROOT / "container"
INSTALL = (CONTAINER / "install.sh").read_text()
LOCKS = ("requirements-uv.txt", "requirements.txt", "requirements-slurm.txt")


def copied(recipe: str) -> list[str]:
    """Files that a recipe copies into the image."""
    text = (CONTAINER / recipe).read_text()
    if recipe == "Containerfile":
        return [name for line in re.findall(r"^COPY (.*)$", text, re.MULTILINE) for name in line.split()[:-1]]
    section = re.search(r"^%files\n(.*?)^%", text, re.MULTILINE | re.DOTALL)
    assert section
    rows = [line.split() for line in section[1].splitlines() if line.strip()]
    assert all(to == f"/opt/lock/{name.rpartition('/')[2]}" for name, to in rows)
    return [name for name, _ in rows]


def pins(name: str) -> dict[str, set[str]]:
    """Versions of each package in a lock file; there are several where they depend on the Python."""
    found: dict[str, set[str]] = {}
    for package, version in re.findall(r"^([a-z0-9_.-]+)==(\S+)", (ROOT / name).read_text(), re.MULTILINE):
        found.setdefault(package, set()).add(version)
    return found


@pytest.mark.parametrize("recipe", ["Containerfile", "kinran.def"])
def test_a_recipe_copies_the_lock_files_and_the_script(recipe: str) -> None:
    names = copied(recipe)
    assert set(names) == {"container/install.sh", *LOCKS}
    assert [name for name in names if not (ROOT / name).is_file()] == []
    assert "/opt/lock/install.sh" in (CONTAINER / recipe).read_text()


def test_both_recipes_start_from_the_same_image() -> None:
    bases = [
        re.search(pattern, (CONTAINER / recipe).read_text(), re.MULTILINE)
        for recipe, pattern in {"Containerfile": r"^FROM (\S+)", "kinran.def": r"^From: (\S+)"}.items()
    ]
    assert len({base and base[1] for base in bases}) == 1


def test_the_script_is_one_that_a_shell_reads() -> None:
    assert subprocess.run(["sh", "-n", str(CONTAINER / "install.sh")], check=False).returncode == 0
    for lock in LOCKS:
        assert f"-r {lock}" in INSTALL
    assert INSTALL.count("--require-hashes") == 2


def test_system_libraries_are_those_of_kinran_and_the_doctor() -> None:
    call = re.search(r"apt-get install (.*?[^\\])\n", INSTALL, re.DOTALL)
    assert call
    asked = {word for word in call[1].replace("\\\n", " ").split() if not word.startswith("-")}
    door = re.search(r'^packages="(.*)"$', (ROOT / "kinran").read_text(), re.MULTILINE)
    assert door
    assert asked - {"ca-certificates", "python3", "python3-venv"} == set(door[1].split())
    assert set(door[1].split()) == set(LIBRARIES.split("--no-install-recommends ")[-1].split())


@pytest.mark.parametrize("lock", LOCKS)
def test_every_package_is_pinned_by_its_hashes(lock: str) -> None:
    text = (ROOT / lock).read_text()
    entries = [part for part in re.split(r"^(?=[a-z0-9])", text, flags=re.MULTILINE) if "==" in part.split("\n")[0]]
    assert entries
    assert [entry.split("\n")[0] for entry in entries if "--hash=sha256:" not in entry] == []
    assert "://" not in text


def test_the_executors_want_no_other_versions() -> None:
    """Both lock files go into one environment."""
    ours, theirs = pins("requirements.txt"), pins("requirements-slurm.txt")
    assert "snakemake-executor-plugin-slurm" in theirs
    shared = ours.keys() & theirs.keys()
    assert "numpy" in shared
    assert {name: theirs[name] for name in shared} == {name: ours[name] for name in shared}
