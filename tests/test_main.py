"""The command line as a whole: what a user finds first, and that every option says what it is for itself."""

import argparse
import importlib
import json
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator

import pytest

from kinran.__main__ import ALL, COMMANDS, STAGES, main, parser_of
from kinran.run.bench import NAMES, load


def parsers(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """A parser and those of its actions."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for choice in action.choices.values():
                yield from parsers(choice)


def check(parser: argparse.ArgumentParser) -> None:
    """What is said of an argument is said of no other."""
    for each in parsers(parser):
        each.format_help()
        actions = [a for a in each._actions if not isinstance(a, argparse._SubParsersAction)]
        texts = [action.help for action in actions if action.help not in (None, argparse.SUPPRESS)]
        assert [text for text, count in Counter(texts).items() if count > 1] == [], each.prog


@pytest.mark.parametrize("name", ALL)
def test_no_two_options_share_a_help_text(name: str) -> None:
    check(parser_of(name, importlib.import_module(ALL[name][0])))


@pytest.mark.parametrize("name", NAMES)
def test_no_two_options_of_a_benchmark_do(name: str) -> None:
    parser = argparse.ArgumentParser(prog=name)
    load(name).add_arguments(parser)
    check(parser)


def test_users_find_their_commands_first(capsys: pytest.CaptureFixture[str]) -> None:
    """Then a line, then the stages, from the plan to the reports."""
    with pytest.raises(SystemExit) as stopped:
        main(["--help"])
    assert stopped.value.code == 0
    lines = capsys.readouterr().out.splitlines()
    words = [line.split()[0] for line in lines if line.startswith("  ") and line.split()[0] in ALL]
    assert words == [*COMMANDS, *STAGES]
    line = next(k for k, text in enumerate(lines) if text.startswith("stages"))
    assert lines[line - 2].split()[0] == list(COMMANDS)[-1]
    assert lines[line + 1].split()[0] == "plan"


@pytest.mark.parametrize("words", [[], ["velvet"], ["demo", "velvet"]])
def test_what_is_no_command_is_refused(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert "usage: kinran" in capsys.readouterr().err


def test_help_is_the_same_without_the_packages_that_take_seconds_to_load(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    program = """
import importlib, json, sys
from kinran.base.stand_ins import StandIns
from kinran.__main__ import ALL, parser_of
sys.meta_path.insert(0, StandIns())
print(json.dumps({name: parser_of(name, importlib.import_module(ALL[name][0])).format_help() for name in ALL}))
print([name for name in ("numpy", "numba", "scipy", "mitsuba") if hasattr(sys.modules.get(name), "__version__")])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    alone, loaded = done.stdout.splitlines()
    assert json.loads(alone) == {
        name: parser_of(name, importlib.import_module(ALL[name][0])).format_help() for name in ALL
    }
    assert loaded == "[]"


def test_help_loads_nothing_else() -> None:
    command = [sys.executable, "-X", "importtime", "-m", "kinran", "merge", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "usage: kinran merge" in done.stdout
    assert "kinran.bracket.superpixels" in done.stderr
    assert "numba.core" not in done.stderr
