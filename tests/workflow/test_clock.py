"""A clock that jumps by a day, forwards and back, in the middle of a run."""

import os
import random
import time

from conftest import Project


def test_times_that_jumped_rerun_nothing(project: Project) -> None:
    """Files from tomorrow and from yesterday, mixed: content decides."""
    chance = random.Random(6)
    for part in ("captures", "results", "config"):
        for path in sorted((project.folder / part).rglob("*")):
            if path.is_file():
                now = time.time() + chance.choice([-1, 1]) * 86_400
                os.utime(path, (now, now))
    assert project.planned() == {}
