"""`kinran test`: what goes to pytest, and what to a suite of its own."""

import subprocess
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from kinran import __main__ as command_line
from kinran.base.project import ROOT
from kinran.run.test import SUITES


@pytest.fixture
def called(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """Programs that would have run; each ends with the status 3."""
    programs: list[list[str]] = []

    def run(program: list[str], **how: Any) -> SimpleNamespace:
        assert how["cwd"] == ROOT
        programs.append(program)
        return SimpleNamespace(returncode=3)

    monkeypatch.setattr(subprocess, "run", run)
    return programs


@pytest.mark.parametrize("words", [["-k", "merge"], ["tests/rig", "-x"], ["-k", "rig-vm"]])
def test_words_go_to_pytest(called: list[list[str]], words: list[str]) -> None:
    with pytest.raises(SystemExit) as end:
        command_line.main(["test", *words])
    assert end.value.code == 3
    assert called == [[sys.executable, "-m", "pytest", *words]]


def test_the_whole_run_takes_two_processes(called: list[list[str]]) -> None:
    with pytest.raises(SystemExit) as end:
        command_line.main(["test"])
    assert end.value.code == 3
    assert called == [[sys.executable, "-m", "pytest", "-n", "3", "--dist", "loadfile", "--no-loadscope-reorder"]]


def test_a_suite_gets_the_words_after_its_name(called: list[list[str]]) -> None:
    with pytest.raises(SystemExit) as end:
        command_line.main(["test", "rig-vm", "hidraw:uhid", "libusb:vhci"])
    assert end.value.code == 3
    assert called == [[sys.executable, "tests/vm/rig_vm.py", "hidraw:uhid", "libusb:vhci"]]


def test_the_help_lists_the_suites(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        command_line.main(["test", "--help"])
    shown = capsys.readouterr().out
    for name, (program, summary) in SUITES.items():
        assert f"{name:15}{summary}" in shown
        assert (ROOT / program.split()[-1]).is_file()
