"""Run the project's tests: library, plugin, workflow and faults, and the style checks; or a suite of its own."""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

from kinran.base.project import ROOT

SUITES = {"slurm": "tests/slurm/on_slurm.py"}
"""Suites that need more than a machine for itself, each with the script that sets it up and runs it."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: all that it does not know go to pytest."""
    parser.epilog = f"Everything else is passed on to pytest, such as -k merge; or to a suite: {', '.join(SUITES)}."


def main(words: Sequence[str]) -> None:
    """Run pytest with these words in the project's root, or the suite that they name; exits with its status."""
    # threads of BLAS that wait for each other over small matrices take longer than one
    settings = {"OMP_NUM_THREADS": "1", **os.environ}
    suite = SUITES.get(words[0]) if words else None
    command = [suite, *words[1:]] if suite else ["-m", "pytest", *words]
    sys.exit(subprocess.run([sys.executable, *command], cwd=ROOT, env=settings, check=False).returncode)
