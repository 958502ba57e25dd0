"""Snakemake as a child of a command, with which it ends: so no run is left behind that nobody sees or can stop."""

import contextlib
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from kinran.base.end_with_run import binding
from kinran.base.project import ROOT
from kinran.rig.stopping import interruptible

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
    with interruptible(), subprocess.Popen(command, cwd=folder, pass_fds=files, preexec_fn=binding()) as snakemake:
        try:
            return snakemake.wait()
        except KeyboardInterrupt:
            with contextlib.suppress(subprocess.TimeoutExpired):
                snakemake.wait(STOPPING_S)
            raise
        finally:
            snakemake.kill()
