"""Whole runs that are killed, disturbed by a second one, or whose config changes; `kinran bench run-kills` does it for
longer.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from killed_runs import FRONT, PHOTOGRAPHED, make_project, processes

from kinran.base.project import ROOT
from kinran.run.owner import LOCKS, owned

MADE = f"captures/{PHOTOGRAPHED}/groups/00.json"
"""What is asked for: two jobs."""


Begin = Callable[..., "subprocess.Popen[bytes]"]
"""Begins a run in this folder, as `kinran rti` does, or another command."""


@pytest.fixture
def begin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Begin]:
    """The small project as this folder; what was begun in it ends with the test."""
    make_project(tmp_path / "project")
    monkeypatch.chdir(tmp_path / "project")
    runs: list[subprocess.Popen[bytes]] = []

    def begin(*words: str, log: str = "run.log") -> "subprocess.Popen[bytes]":
        command = words or ("-c", FRONT, "--cores", "1", "--quiet", "rules", "--", MADE)
        with Path(log).open("wb") as said:
            runs.append(subprocess.Popen([sys.executable, *command], stdout=said, stderr=said, start_new_session=True))
        return runs[-1]

    yield begin
    for run in runs:
        for process in [run.pid, *processes(run.pid)] if run.poll() is None else []:
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        run.wait()


def wait_for(found: Callable[[], int], run: "subprocess.Popen[bytes]") -> int:
    """Wait until something is found, while a run goes on."""
    while not (what := found()):
        assert run.poll() is None, Path("run.log").read_text()
        time.sleep(0.05)
    return what


def stopped_job(run: "subprocess.Popen[bytes]") -> int:
    """Wait for a job of a run, stop it where it is (SIGSTOP), and return its process."""

    def find() -> int:
        below = processes(run.pid)
        return next((pid for pid, words in below.items() if "-m kinran " in words and "bash" not in words), 0)

    job = wait_for(find, run)
    os.kill(job, signal.SIGSTOP)
    return job


def gone(process: int) -> bool:
    """Whether a process has ended."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


def test_two_at_once_killed_and_run_again(begin: Begin) -> None:
    first = begin()
    job = stopped_job(first)
    assert begin(log="second.log").wait() != 0
    second = Path("second.log").read_text()
    assert "another run works in this folder (process " in second
    assert "Traceback" not in second
    os.kill(job, signal.SIGKILL)  # as the kernel does where memory runs out
    assert first.wait() != 0
    (failure,) = json.loads(Path("results/failures.json").read_bytes())["failures"][:1]
    assert failure["says"].startswith(
        "kinran ingest: was killed, most likely as memory ran out; run fewer jobs at once"
    )

    run = begin()
    left = [*processes(run.pid), stopped_job(run), *processes(run.pid)]
    assert LOCKS.is_dir()
    run.kill()
    run.wait()
    for process in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(process, signal.SIGCONT)
    deadline = time.monotonic() + 60
    while not all(gone(process) for process in left):
        assert time.monotonic() < deadline, "something of a killed run lives on"
        time.sleep(0.05)
    assert LOCKS.is_dir()
    assert not Path(MADE).exists()

    again = begin()
    job = stopped_job(again)
    sheet = Path("config/fabrics.tsv")
    sheet.write_text(sheet.read_text().replace("srgb", "linear"))
    os.kill(job, signal.SIGCONT)
    assert again.wait() == 0, Path("run.log").read_text()
    assert "was killed (process " in Path("run.log").read_text()
    assert Path(MADE).exists()
    assert not LOCKS.exists()
    plan = json.loads(Path(f"captures/{PHOTOGRAPHED}/plan.json").read_bytes())
    assert plan["encoding"] == "srgb"  # jobs of this machine keep what their run began with


def test_ctrl_c_is_one_clean_stop(begin: Begin) -> None:
    """A terminal sends it to the command, to Snakemake and to the jobs, all at once."""
    run = begin("-m", "kinran", "rti", "photographs", "--out", "rti", "--cores", "1")
    os.kill(stopped_job(run), signal.SIGCONT)
    os.killpg(run.pid, signal.SIGINT)
    assert run.wait() == 130
    log = Path("run.log").read_text()
    assert "Traceback" not in log
    assert log.splitlines()[-1] == "kinran rti: stopped"
    assert not Path("rti/.kinran", LOCKS).exists()


@pytest.mark.usefixtures("begin")
def test_a_job_elsewhere_refuses_a_config_that_has_changed() -> None:
    """Such jobs read config and sheets again; `kinran.run.owner` has what the run began with."""
    job = [
        sys.executable,
        "-m",
        "snakemake",
        "--snakefile",
        str(ROOT / "Snakefile"),
        "--cores",
        "1",
        "--mode",
        "remote",
    ]
    job += ["--nolock", "--target-jobs", f"ingest:fabric={PHOTOGRAPHED}", "--quiet", "rules", "--force"]
    with owned({PHOTOGRAPHED: "what it was"}):
        done = subprocess.run(job, capture_output=True, text=True, check=False)
    said = f"fabric '{PHOTOGRAPHED}': its settings have changed since the run began, so this job is not run"
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert done.returncode == 1
