"""kill -9 of stages at random steps: what they wrote is whole, and the next attempt writes the same."""

import json
import random
import re
import shlex
import signal
from pathlib import Path

from conftest import Project
from killed_runs import content
from killed_stages import stages

from kinran.run.owner import PART

STAGES = ("plan", "calibrate", "merge-group", "stack", "segment", "prior", "fit", "material")
KILLS = 1
"""Kills of each stage: those of captures are in tests/fault."""


def commands(folder: Path) -> dict[str, list[str]]:
    """The command of a job of each stage, as Snakemake noted it."""
    found: dict[str, list[str]] = {}
    for path in sorted((folder / ".snakemake/metadata").iterdir()):
        for command in re.findall(
            r"python -m kinran (.+?)(?: 2>&1|;|$)", json.loads(path.read_bytes())["shellcmd"] or ""
        ):
            words = shlex.split(command)
            found.setdefault(words[0], words)
    return found


def snapshot(folder: Path) -> dict[Path, bytes]:
    """All files of a project that runs make, without costs."""
    return {
        path: b"" if path.name.startswith(".") else content(path)
        for part in ("results", "captures")
        for path in (folder / part).rglob("*")
        if path.is_file() and path.parent.name != "benchmarks"
    }


def test_killed_at_random_steps(project: Project) -> None:
    chance, kills = random.Random(13), 0
    folder, known = project.folder, commands(project.folder)
    with stages(*STAGES) as run:
        for stage in STAGES:
            code, steps = run.one(folder, known[stage])
            assert (code, steps > 0) == (0, True), stage
            before = snapshot(folder)
            for _ in range(KILLS):
                code, _ = run.one(folder, known[stage], chance.randint(1, steps))
                kills += code == -signal.SIGKILL
                assert code in (0, -signal.SIGKILL), stage  # a fit goes on where it was, in fewer steps
                after = snapshot(folder)
                assert not [path for path, was in before.items() if after.get(path, was) != was], stage
                new = {path.relative_to(folder) for path in after.keys() - before.keys()}
                assert all(
                    any(PART.fullmatch(part) or part.endswith(".tiles") for part in path.parts) for path in new
                ), new
            assert run.one(folder, known[stage])[0] == 0
            after = snapshot(folder)
            assert {path: after.get(path) for path in before} == before, stage
    assert kills >= KILLS * (len(STAGES) - 1)
