"""`kinran test`: words go to pytest, or to the suite that the first of them names."""

import subprocess
import sys
from collections.abc import Sequence

import pytest

from kinran.base.project import ROOT
from kinran.run import test as suites


@pytest.mark.parametrize("name", suites.SUITES)
def test_a_suite_is_a_script(name: str) -> None:
    assert (ROOT / suites.SUITES[name]).is_file()


@pytest.mark.parametrize(
    ("words", "command"),
    [
        ([], ["-m", "pytest"]),
        (["-k", "slurm"], ["-m", "pytest", "-k", "slurm"]),
        (["slurm", "-x"], ["tests/slurm/on_slurm.py", "-x"]),
    ],
)
def test_words_go_to_pytest_or_to_a_suite(
    monkeypatch: pytest.MonkeyPatch, words: Sequence[str], command: list[str]
) -> None:
    """Its status is that of the command."""
    called: list[list[str]] = []

    def run(command: list[str], **_: object) -> "subprocess.CompletedProcess[str]":
        called.append(command)
        return subprocess.CompletedProcess(command, 2)

    monkeypatch.setattr(subprocess, "run", run)
    with pytest.raises(SystemExit) as stopped:
        suites.main(words)
    assert stopped.value.code == 2
    assert called == [[sys.executable, *command]]
