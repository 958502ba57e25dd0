"""A job ends with the run that began it: when its Snakemake is gone, whatever ended it, the job ends by itself.

Otherwise a job that a killed run left behind would write the same files as that of the next run. Until it has ended it
holds a lock, for which the next run waits (`kinran.run.owner`).
"""

import contextlib
import ctypes
import fcntl
import logging
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

RUN = "KINRAN_RUN"
"""Variable of the environment with the number of the Snakemake's process that began a job."""
JOBS = Path(".snakemake/kinran.jobs")
"""File that all jobs of a run lock together, in the working folder; the next run waits until nobody does."""
GRACE_S = 60.0
"""Seconds in which a job may end in good order, such as a rig that stops its arm: a choice."""
PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that a process gets when its parent ends."""

log = logging.getLogger(__name__)


def end_with_run(environment: Mapping[str, str] = os.environ) -> None:
    """Watch the run that began this process, from a thread, and end with it: by SIGTERM, or else after `GRACE_S`.

    Does nothing where no run began this process, or where it cannot be seen (in a container with processes of its own,
    or on a system without pidfd).
    """
    run = environment.get(RUN, "")
    if not run.isdigit() or not hasattr(os, "pidfd_open"):
        return
    try:
        watched = os.pidfd_open(int(run))
    except ProcessLookupError:
        if "APPTAINER_CONTAINER" not in environment:
            _end(int(run))
        return
    except OSError:
        return
    _hold_jobs()
    if _gone(watched, 0):  # before this process held the lock that tells the next run of it
        _end(int(run))
    threading.Thread(target=_wait, args=(watched, int(run)), daemon=True, name="end_with_run").start()


def _hold_jobs() -> None:
    """Hold the lock of the run's jobs until this process ends; its children hold it, too, if they are forks."""
    with contextlib.suppress(OSError):  # no file, or a file system without locks
        fcntl.flock(os.open(JOBS, os.O_RDONLY), fcntl.LOCK_SH)


def _gone(watched: int, seconds: float | None) -> bool:
    """Return whether the process of a pidfd has ended, waiting for that so many seconds; None: without an end."""
    return bool(select.select([watched], [], [], seconds)[0])


def _wait(watched: int, run: int) -> None:
    _gone(watched, None)
    _end(run)


def _end(run: int) -> None:
    log.error("the run that began this job (Snakemake, process %d) has ended; the job ends, too", run)
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(GRACE_S)
    os._exit(128 + signal.SIGTERM)


def binding() -> Callable[[], object] | None:
    """Return what a new process calls to be killed when its parent ends; nothing on systems without prctl(2)."""
    if sys.platform != "linux":
        return None
    return partial(ctypes.CDLL(None).prctl, PR_SET_PDEATHSIG, signal.SIGKILL)


def end_with_parent(parent: int) -> None:
    """Have this process, a worker of a stage, killed when the stage ends, however that comes about.

    A worker that is left behind holds what the stage wrote its log to, and Snakemake waits for that for ever.

    Parameters
    ----------
    parent
        Number of the stage's process.
    """
    if bind := binding():
        bind()
    if os.getppid() != parent:  # it had ended before
        os._exit(128 + signal.SIGKILL)
