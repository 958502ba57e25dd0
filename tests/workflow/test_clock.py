"""A clock that is a day ahead for a part of a run."""

import os
import random
import time

from conftest import Project

LARGEST = 1_000_000
"""Bytes of the largest file of which Snakemake takes a checksum by default (`--max-checksum-file-size`)."""


def test_times_that_jumped_rerun_nothing(project: Project) -> None:
    """Files from tomorrow and of today, mixed: content decides, up to the size that Snakemake looks into."""
    chance = random.Random(6)
    for part in ("captures", "results", "config"):
        for path in sorted((project.folder / part).rglob("*")):
            if path.is_file() and path.stat().st_size <= LARGEST:
                now = time.time() + chance.choice([0, 1]) * 86_400
                os.utime(path, (now, now))
    assert project.planned() == {}
