"""How far a run is, and how long it will still take."""

import logging
import sys
from enum import Enum, auto

import pytest

from kinran.run.progress import Job, Progress, in_words, schedule


class Event(Enum):
    """Events with the names that Snakemake gives them."""

    JOB_STARTED = auto()
    JOB_ERROR = auto()
    JOB_FINISHED = auto()


class Run:
    """A run with a clock that is set by hand."""

    def __init__(self, jobs: dict[int, Job], slots: int) -> None:
        self.now = 100.0
        self.progress = Progress(lambda: (jobs, slots), lambda: self.now)

    def started(self, at: float, *jobs: int) -> None:
        self.emit(at, Event.JOB_STARTED, jobs=list(jobs))

    def finished(self, at: float, job: int) -> None:
        self.emit(at, Event.JOB_FINISHED, job_id=job)

    def emit(self, at: float, event: Event, **said: object) -> None:
        self.now = 100.0 + at
        self.progress.handle(logging.makeLogRecord({"event": event, **said}))

    @property
    def left(self) -> float:
        return self.progress.left(self.now)


def job(seconds: float | None, *after: int, rule: str = "merge", slots: int = 1) -> Job:
    return Job(rule, seconds, slots, frozenset(after))


@pytest.mark.parametrize(
    ("jobs", "slots", "seconds"),
    [
        ({k: job(10) for k in range(6)}, 2, 30),
        ({0: job(10), 1: job(20, 0), 2: job(5, 1)}, 8, 35),  # no number of cores shortens a chain
        ({0: job(10), 1: job(10), 2: job(10, slots=2)}, 2, 20),
        ({0: job(10, slots=2), 1: job(10, slots=8)}, 4, 20),  # cut to the cores that there are
        ({0: job(10, 77)}, 1, 10),  # 77 is done, or was never needed
        ({0: job(10), 1: job(10)}, sys.maxsize, 10),
        ({}, 2, 0),
    ],
)
def test_jobs_are_put_on_cores_each_after_those_that_it_waits_for(
    jobs: dict[int, Job], slots: int, seconds: float
) -> None:
    assert schedule({key: (j.seconds or 0, j) for key, j in jobs.items()}, slots, set()) == seconds


def test_what_jobs_took_corrects_what_is_predicted_for_others() -> None:
    jobs = {0: job(10), 1: job(10), 2: job(10, rule="fit"), 3: job(10, rule="prior")}
    run = Run(jobs, 1)
    run.started(0, 0)
    assert run.left == 40
    run.finished(30, 0)
    assert run.left == 90  # all take three times as long
    run.started(30, 2)
    run.finished(35, 2)
    assert run.left == pytest.approx(30 + 10 * 35 / 20)  # a merge as merges do, a prior as all jobs do


def test_a_job_that_runs_has_less_left_and_never_less_than_nothing() -> None:
    run = Run({0: job(10), 1: job(20)}, 2)
    run.started(0, 0, 1)
    run.now += 15
    assert run.left == 5
    run.now += 15
    assert run.left == 0


def test_a_job_of_another_workflow_counts_as_the_mean_and_one_that_failed_as_nothing() -> None:
    run = Run({0: job(10), 1: job(30), 2: job(None), 3: job(500, 0)}, 1)
    run.started(0, 0)
    run.emit(10, Event.JOB_ERROR, jobid=0)
    assert run.left == 30 + 180
    run.started(10, 0)  # a new attempt
    assert run.left == 10 + 30 + 180 + 500


def test_a_line_now_and_then_and_one_at_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    run = Run({k: job(4) for k in range(5)}, 1)
    for k in range(5):
        run.started(4 * k, k)
        run.finished(4 * k + 4, k)
    assert capsys.readouterr().err.splitlines() == [
        "kinran: 3 of 5 jobs, 12 s gone, about 8 s left",
        "kinran: 5 of 5 jobs, 20 s gone",
    ]


def test_jobs_of_a_group_are_started_by_its_name_alone(capsys: pytest.CaptureFixture[str]) -> None:
    """Nobody knows what each of them took."""
    run = Run({0: job(10), 1: job(10, 0), 2: job(10)}, 1)
    run.emit(0, Event.JOB_STARTED, jobs=["0b5c"])
    run.finished(60, 0)
    assert run.left == 20
    assert capsys.readouterr().err == "kinran: 1 of 3 jobs, 1 min 0 s gone, about 20 s left\n"


def test_what_is_no_event_of_a_job_is_none(capsys: pytest.CaptureFixture[str]) -> None:
    run = Run({}, 1)
    run.progress.handle(logging.makeLogRecord({"msg": "Building DAG of jobs..."}))
    assert capsys.readouterr().err == ""


def test_words() -> None:
    assert [in_words(s) for s in (3.4, 59, 75, 599, 600, 5900, 9000)] == [
        *("3 s", "59 s", "1 min 10 s", "9 min 50 s", "10 min", "98 min", "2.5 h"),
    ]
