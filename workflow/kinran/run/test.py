"""Run the project's tests: library, plugin, workflow and faults, and the style checks."""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

from kinran.base.project import ROOT


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: all that it does not know go to pytest."""
    parser.epilog = "Everything else is passed on to pytest, such as -k merge."


def main(words: Sequence[str]) -> None:
    """Run pytest with these words in the project's root; exits with its status."""
    # threads of BLAS that wait for each other over small matrices take longer than one
    settings = {"OMP_NUM_THREADS": "1", **os.environ}
    sys.exit(subprocess.run([sys.executable, "-m", "pytest", *words], cwd=ROOT, env=settings, check=False).returncode)
