"""How long a whole run will take: a line of progress now and then, with the time that is left.

Snakemake counts jobs, of which some take a second and some an hour. Here each has the time that is predicted for it
(`resources.py`), corrected by what the jobs took that this run has finished; and what is left is put on the cores, each
job after those that it waits for.
"""

import heapq
import logging
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

EVERY_S = 10.0
"""Seconds between two lines, at least. A choice: jobs of a tiny fabric finish in less."""


@dataclass(frozen=True)
class Job:
    """A job that a run has to do.

    Attributes
    ----------
    rule
        Its rule.
    seconds
        The time that is predicted for it; None where nobody can say.
    slots
        Cores that it takes, or one where a job is sent elsewhere.
    after
        Ids of the jobs that it waits for.
    """

    rule: str
    seconds: float | None
    slots: int
    after: frozenset[int]


def jobs_of(workflow: Any, predicted: Callable[[Any], float | None]) -> tuple[dict[int, Job], int]:
    """Return the jobs that Snakemake is about to do by their ids, and the cores or jobs that there are at a time.

    Parameters
    ----------
    workflow
        Snakemake's workflow.
    predicted
        Returns the seconds of a job of Snakemake's, and None where nobody can say.
    """
    dag, here = workflow.dag, workflow.local_exec
    found = {
        job.jobid: Job(
            job.rule.name,
            predicted(job),
            job.threads if here else 1,
            frozenset(before.jobid for before in dag.dependencies[job]),
        )
        for job in dag.needrun_jobs()
    }
    return found, workflow.cores if here else workflow.nodes


class Progress(logging.Handler):
    """Says how far a run is, from what Snakemake logs, whatever of it is shown.

    Parameters
    ----------
    jobs
        Returns what `jobs_of` does. It is called once, when the first job starts: a dry run never does.
    clock
        Returns the time in seconds.
    """

    def __init__(self, jobs: Callable[[], tuple[Mapping[int, Job], int]], clock: Callable[[], float] = time.monotonic):
        super().__init__()
        self.find, self.clock = jobs, clock
        self.jobs: Mapping[int, Job] = {}
        self.slots = 1
        self.started: dict[int, float] = {}
        """When each job began, by its id."""
        self.took: dict[int, float] = {}
        """Seconds of each job that has finished; 0 where only the end of its group is known."""
        self.failed: set[int] = set()
        self.began = self.said = 0.0

    def emit(self, record: logging.LogRecord) -> None:
        event, said, now = getattr(getattr(record, "event", None), "name", ""), vars(record), self.clock()
        if event == "JOB_STARTED":
            if not self.jobs:
                self.jobs, self.slots = self.find()
                self.began = self.said = now
            self.started.update(dict.fromkeys(said["jobs"], now))
            self.failed.difference_update(said["jobs"])
        elif event == "JOB_ERROR":
            self.failed.add(said["jobid"])
        elif event == "JOB_FINISHED":
            self.took[said["job_id"]] = now - self.started.get(said["job_id"], now)
            if now - self.said >= EVERY_S or len(self.took) == len(self.jobs):
                self.said = now
                with suppress(BrokenPipeError):
                    print(self.line(now), file=sys.stderr, flush=True)

    def line(self, now: float) -> str:
        """Return what there is to say at a time."""
        text = f"kinran: {len(self.took)} of {len(self.jobs)} jobs, {in_words(now - self.began)} gone"
        return text if len(self.took) == len(self.jobs) else f"{text}, about {in_words(self.left(now))} left"

    def left(self, now: float) -> float:
        """Seconds that are left: those of a schedule of all jobs that have not finished, and can."""
        seconds = self.expected()
        return schedule(
            {
                key: (max(seconds[key] - (now - self.started.get(key, now)), 0.0), job)
                for key, job in self.jobs.items()
                if key not in self.took
            },
            self.slots,
            self.failed,
        )

    def expected(self) -> dict[int, float]:
        """Seconds of each job: as predicted, times what jobs of its rule took over that, or all jobs if none did."""
        measured: defaultdict[str, list[tuple[float, float]]] = defaultdict(list)
        for key, took in self.took.items():
            job = self.jobs.get(key)
            if job and job.seconds and took:
                measured[job.rule].append((took, job.seconds))
        overall = _ratio([pair for pairs in measured.values() for pair in pairs])
        known = [job.seconds for job in self.jobs.values() if job.seconds is not None]
        mean = sum(known) / max(len(known), 1)
        return {
            key: (mean if job.seconds is None else job.seconds)
            * (_ratio(measured[job.rule]) if job.rule in measured else overall)
            for key, job in self.jobs.items()
        }


def _ratio(pairs: list[tuple[float, float]]) -> float:
    """Return seconds that were measured over those predicted; 1 where nothing was."""
    return sum(took for took, _ in pairs) / sum(predicted for _, predicted in pairs) if pairs else 1.0


def schedule(jobs: Mapping[int, tuple[float, Job]], slots: int, failed: set[int]) -> float:
    """Return the seconds until jobs are done, each with its own seconds, that start as soon as they can.

    Parameters
    ----------
    jobs
        Seconds and job, by its id. What a job waits for and is not among them is done.
    slots
        Cores.
    failed
        Jobs that nobody does, nor what waits for them.
    """
    waits = {key: {other for other in job.after if other in jobs} for key, (_, job) in jobs.items()}
    followers: defaultdict[int, list[int]] = defaultdict(list)
    for key, others in waits.items():
        for other in others:
            followers[other].append(key)
    ready = [(0.0, key) for key in jobs if not waits[key] and key not in failed]
    heapq.heapify(ready)
    slots = max(1, min(slots, sum(job.slots for _, job in jobs.values())))  # there may be any number of nodes
    free, end = [0.0] * slots, 0.0
    while ready:
        since, key = heapq.heappop(ready)
        seconds, job = jobs[key]
        taken = min(job.slots, slots)
        done = max(since, free[taken - 1]) + seconds
        free = sorted([done] * taken + free[taken:])
        end = max(end, done)
        for follower in followers[key]:
            waits[follower].discard(key)
            if not waits[follower] and follower not in failed:
                heapq.heappush(ready, (done, follower))
    return end


def in_words(seconds: float) -> str:
    """Return a time in words, as exact as anybody needs it."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    if seconds < 600:
        return f"{seconds // 60:.0f} min {seconds % 60 // 10 * 10:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
