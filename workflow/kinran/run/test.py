"""Run the project's tests: library, plugin, workflow and faults, and the style checks; or a suite of its own."""

import argparse
import os
import subprocess
import sys
from collections.abc import Sequence

from kinran.base.project import ROOT

SUITES = {
    "camera": ("-m pytest -m slow tests/fault/test_eos_faults.py", "captures with an emulated camera that misbehaves"),
    "rig-vm": ("tests/vm/rig_vm.py", "the rig's driver and commands on a Linux kernel in a virtual machine"),
    "slurm": ("tests/slurm/on_slurm.py", "the workflow on a SLURM cluster of virtual nodes on this machine"),
}
"""Suites of their own, which need more than Python or wait for minutes: the words after `python`, what each tests."""

WHOLE = ("-n", "3", "--dist", "loadfile", "--no-loadscope-reorder")
"""Words of the whole run: three processes, as some tests only wait; each has whole files, whose tests share what took
long to make."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command: all that it does not know go to pytest, or to the suite."""
    rows = [f"  {name:15}{summary}" for name, (_, summary) in SUITES.items()]
    parser.usage = "kinran test [-h] [WORD …] | kinran test SUITE [WORD …]"
    parser.epilog = "\n".join(["Words are passed on to pytest, such as -k merge.", "\nsuites of their own:", *rows])


def main(words: Sequence[str]) -> None:
    """Run pytest, or the suite that the first word names, with these words in the project's root.

    Exits with its status.
    """
    # threads of BLAS that wait for each other over small matrices take longer than one
    settings = {"OMP_NUM_THREADS": "1", **os.environ}
    program = ["-m", "pytest", *(words or WHOLE)]
    if words and words[0] in SUITES:
        program = [*SUITES[words[0]][0].split(), *words[1:]]
    sys.exit(subprocess.run([sys.executable, *program], cwd=ROOT, env=settings, check=False).returncode)
