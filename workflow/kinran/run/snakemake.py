"""Snakemake as a child of a command, with which it ends: so no run is left behind that nobody sees or can stop."""

import contextlib
import ctypes
import signal
import subprocess
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from kinran.base.project import ROOT
from kinran.rig.stopping import interruptible

PR_SET_PDEATHSIG = 1
"""Option of prctl(2): the signal that a process gets when its parent ends."""
STOPPING_S = 10.0
"""Longest wait in seconds for a Snakemake that was interrupted, and removes what jobs left half done: a choice."""


def run_snakemake(options: Sequence[str], folder: Path | None = None, files: Sequence[int] = ()) -> int:
    """Run the project's rules, and return the exit code.

    When this process is killed, so is Snakemake, and its jobs end with it (`kinran.base.end_with_run`). After Ctrl-C,
    which a terminal sends to all of them, Snakemake gets the time to clear up.

    Parameters
    ----------
    options
        Options and targets of Snakemake.
    folder
        Working folder; None for that of this process.
    files
        Descriptors that Snakemake inherits.

    Raises
    ------
    KeyboardInterrupt
        This process got a signal that ends it.
    """
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), *options]
    with interruptible(), subprocess.Popen(command, cwd=folder, pass_fds=files, preexec_fn=_bound()) as snakemake:
        try:
            return snakemake.wait()
        except KeyboardInterrupt:
            with contextlib.suppress(subprocess.TimeoutExpired):
                snakemake.wait(STOPPING_S)
            raise
        finally:
            snakemake.kill()


def _bound() -> Callable[[], object] | None:
    """Return what binds the life of a new process to that of its parent; nothing on systems without prctl(2)."""
    if sys.platform != "linux":
        return None
    return partial(ctypes.CDLL(None).prctl, PR_SET_PDEATHSIG, signal.SIGKILL)
