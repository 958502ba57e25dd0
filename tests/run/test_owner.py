"""A run owns its folder: a second one is refused in a sentence, and what a dead one left is cleared away."""

import fcntl
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kinran.base.end_with_run import JOBS, RUN
from kinran.base.files import InputError
from kinran.run import owner
from kinran.run.fabrics import Fabrics

HOLDS = """
import os, sys, time
from kinran.run.owner import owned
with owned({}):
    print("owned", flush=True)
    time.sleep(60)
"""
JOB = """
import sys, time
from kinran.base.end_with_run import end_with_run
end_with_run()
print("works", flush=True)
time.sleep(60)
"""


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def start(program: str, says: str, **environment: str) -> "subprocess.Popen[str]":
    """Start a program, and wait until it says that it is at work."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **environment}
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stdout
    assert process.stdout.readline() == f"{says}\n"
    return process


def kill(process: "subprocess.Popen[str]") -> None:
    process.kill()
    process.communicate()


def enter() -> None:
    with owner.owned({}):
        pass


def test_a_second_run_is_refused_and_says_by_whom() -> None:
    first = start(HOLDS, "owned")
    try:
        with pytest.raises(InputError, match=rf"another run works in this folder \(process {first.pid} on .+, since 2"):
            enter()
    finally:
        kill(first)


def test_what_a_killed_run_left_is_cleared_away(caplog: pytest.LogCaptureFixture) -> None:
    """Snakemake's lock and half-written files; not the files of the user, which only look alike."""
    first = start(HOLDS, "owned")
    owner.LOCKS.mkdir()
    (owner.LOCKS / "0.output.lock").touch()
    left = [Path("results/silk/.need.77.part.json"), Path("results/silk/radiance.zarr/.part-ab_1/x/zarr.json")]
    kept = [Path("results/silk/need.json"), Path("results/silk/.mine.part.json"), Path("notes/.need.77.part.json")]
    for path in (*left, *kept):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    kill(first)
    with owner.owned({}):
        assert not owner.LOCKS.exists()
        assert [path.exists() for path in (*left, *kept)] == [False, False, True, True, True]
    assert f"killed (process {first.pid}" in caplog.text


def test_after_its_end_a_run_leaves_the_locks_of_others_alone() -> None:
    """Another workflow's lock in the same folder is none of ours."""
    enter()
    owner.LOCKS.mkdir()
    with owner.owned({}):
        assert owner.LOCKS.exists()


def test_a_run_that_failed_is_no_end() -> None:
    with pytest.raises(RuntimeError), owner.owned({}):
        raise RuntimeError
    before = owner.read(owner.FILE)
    assert before
    assert not before.ended


def test_the_next_run_waits_for_the_jobs_of_a_dead_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs hold a lock together; one that does not end is named in a sentence."""
    monkeypatch.setattr(owner, "WAIT_S", 2 * owner.LOOK_S)
    kill(start(HOLDS, "owned"))
    with JOBS.open() as job:
        fcntl.flock(job, fcntl.LOCK_SH)
        with pytest.raises(
            InputError, match=r"jobs of a run that was killed \(process \d+ .+ still work in this folder"
        ):
            enter()
    enter()


def test_a_job_ends_when_its_run_is_killed() -> None:
    """By SIGTERM, which a rig takes for an orderly stop; until then it holds the lock of the jobs."""
    run = start(HOLDS, "owned")
    job = start(JOB, "works", **{RUN: str(run.pid)})
    with JOBS.open() as jobs, pytest.raises(BlockingIOError):
        fcntl.flock(jobs, fcntl.LOCK_EX | fcntl.LOCK_NB)
    kill(run)
    job.communicate(timeout=60)
    assert job.returncode == -signal.SIGTERM
    with JOBS.open() as jobs:
        fcntl.flock(jobs, fcntl.LOCK_EX | fcntl.LOCK_NB)
    late = subprocess.run(
        [sys.executable, "-c", JOB], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), RUN: str(run.pid)},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (late.returncode, late.stdout) == (-signal.SIGTERM, "")
    assert "the run that began this job" in late.stderr


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"host": "elsewhere"}, "another run may work in this folder .* delete"),
        ({}, "another run works in this folder"),
        ({"began": "1"}, None),  # its number is that of another process now
        ({"ended": True}, None),
    ],
)
def test_without_locks_the_file_says_who_owns_the_folder(
    monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], says: str | None
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(owner.NO_LOCKS[0], "No locks available")

    with owner.owned({}):
        mine = owner.read(owner.FILE)
    assert mine
    with owner.FILE.open("rb+") as file:
        owner._write(file.fileno(), replace(mine, **{"ended": False, **change}))
    monkeypatch.setattr(fcntl, "flock", refuse)
    if says is None:
        enter()
        return
    with pytest.raises(InputError, match=says):
        enter()


def test_a_folder_that_cannot_be_written_to() -> None:
    Path(".snakemake").touch()
    with pytest.raises(InputError, match=r"\.snakemake: cannot be written to \(.+\), and a run keeps its books there"):
        enter()


def test_jobs_elsewhere_refuse_other_settings_than_the_run_began_with(monkeypatch: pytest.MonkeyPatch) -> None:
    read = {"silk": "1", "wool": "2"}
    listed = Fabrics({}, {}, {})
    monkeypatch.setattr(owner, "digests", lambda _: read)
    with owner.owned({"silk": "1", "wool": "1"}):
        owner.check_settings(listed, {"silk", ""})
        with pytest.raises(InputError, match="fabric 'wool': its settings have changed since the run began"):
            owner.check_settings(listed, {"wool"})
        with pytest.raises(InputError, match="its folder is not mounted"):
            owner.check_settings(replace(listed, broken={"wool": "its folder is not mounted"}), {"wool"})
    owner.check_settings(listed, {"wool"})
