"""Stages that are killed before a random step: before a file is opened for writing, made, renamed or removed.

Run as a script it starts stages as forks of itself, which have all modules from the start: a line of JSON asks for one,
a line answers with its exit code and the number of its steps.
"""

import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinran.__main__ import ALL, main

CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate")
"""Events that change a folder (PEP 578)."""


class Stages:
    """The process that starts stages."""

    def __init__(self, process: "subprocess.Popen[str]") -> None:
        self._process = process

    def one(self, folder: Path, command: list[str], kill_at: int = 0) -> tuple[int, int]:
        """Run a stage in a folder, killed before a step of this number; returns its exit code, and its steps."""
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps([str(folder), command, kill_at]) + "\n")
        self._process.stdin.flush()
        code, steps = json.loads(self._process.stdout.readline())
        return code, steps


@contextmanager
def stages(*names: str) -> Iterator[Stages]:
    """Start the process that starts stages of these names; it ends with the block."""
    command = [sys.executable, __file__, *names]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        yield Stages(process)


def count_steps(folder: Path, kill_at: int, told: int) -> None:
    """Count the steps of this process in a folder, tell them as lines, and kill it before one of this number."""
    steps = 0

    def step(event: str, arguments: tuple[Any, ...]) -> None:
        nonlocal steps
        opened = event == "open" and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        if not (opened or event in CHANGES) or not isinstance(arguments[0], str | bytes | os.PathLike):
            return
        if not Path(os.fsdecode(arguments[0])).absolute().is_relative_to(folder):
            return
        steps += 1
        os.write(told, b".")
        if steps == kill_at:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(step)


def fork_stages() -> None:
    """Fork a stage for each line, and write its exit code and its steps."""
    for name in sys.argv[1:]:
        importlib.import_module(ALL[name][0])
    for text in sys.stdin:
        folder, command, kill_at = json.loads(text)
        reads, told = os.pipe()
        child = os.fork()
        if not child:
            os.chdir(folder)
            os.dup2(2, 1)
            count_steps(Path(folder), kill_at, told)
            os._exit(main(command))
        os.close(told)
        with os.fdopen(reads, "rb") as steps:
            number = len(steps.read())
        print(json.dumps([os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), number]), flush=True)


if __name__ == "__main__":
    fork_stages()
