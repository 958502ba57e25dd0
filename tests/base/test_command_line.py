"""The command line of a stage is that of its types."""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import pytest

from kinran.base import command_line


@dataclass(frozen=True)
class Inputs:
    frames: Annotated[tuple[Path, ...], "FRAME", "frames of a bracket"]
    prior: Annotated[Path | None, "priors (.json)"] = None


@dataclass(frozen=True)
class Options:
    lobes: Annotated[Literal[1, 2], "lobes"] = 1
    crop: Annotated[tuple[int, int], "X,Y", lambda text: tuple(int(v) for v in text.split(","))] = (0, 0)
    labels: Annotated[tuple[int, ...] | None, "labels"] = None
    quiet: Annotated[bool, "say nothing"] = False
    field_mm: Annotated[float | None, "--field-mm MM", "width of the field"] = None


def called(*words: str) -> dict[str, Any]:
    found: dict[str, Any] = {}

    def main(inputs: Inputs, out: Annotated[Path, "radiance (.exr)"], options: Options = Options()) -> None:
        found.update(inputs=inputs, out=out, options=options)

    parser = argparse.ArgumentParser()
    command_line.add_arguments(parser, main)
    command_line.call(main, parser.parse_args(words))
    return found


def test_words_become_values() -> None:
    got = called("a", "b", "--out", "c", "--lobes", "2", "--labels", "3", "4", "--quiet", "--prior", "p")
    assert got["inputs"] == Inputs((Path("a"), Path("b")), Path("p"))
    assert got["out"] == Path("c")
    assert got["options"].lobes == 2
    assert got["options"].labels == (3, 4)
    assert got["options"].quiet


def test_defaults_stay() -> None:
    assert called("a", "--out", "c")["options"] == Options()


def test_function_makes_the_value() -> None:
    assert called("a", "--out", "c", "--crop", "5,6")["options"].crop == (5, 6)


def test_value_has_a_name_in_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert called("a", "--out", "c", "--field-mm", "60")["options"].field_mm == 60
    with pytest.raises(SystemExit):
        called("--help")
    told = capsys.readouterr().out
    assert "--field-mm MM" in told
    assert "--prior PRIOR" in told
    assert "--lobes {1,2}" in told


@pytest.mark.parametrize("words", [("--labels", "3", "4"), ("--labels", "3", "--labels", "4")])
def test_several_values_follow_one_name_or_each_its_own(words: tuple[str, ...]) -> None:
    assert called("a", "--out", "c", *words)["options"].labels == (3, 4)


@pytest.mark.parametrize("words", [("a",), ("--out", "c"), ("a", "--out", "c", "--lobes", "3")])
def test_what_is_missing_or_wrong_is_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit):
        called(*words)


def test_argument_without_help_is_refused() -> None:
    def main(out: Path) -> None:
        pass

    with pytest.raises(TypeError, match="help"):
        command_line.add_arguments(argparse.ArgumentParser(), main)


def test_input_and_output_may_have_one_name() -> None:
    found: dict[str, Any] = {}

    @dataclass(frozen=True)
    class Outputs:
        prior: Annotated[Path, "OUT", "priors (.json)"]

    def main(inputs: Inputs, out: Outputs) -> None:
        found.update(inputs=inputs, out=out)

    main.__annotations__["out"] = Outputs
    parser = argparse.ArgumentParser()
    command_line.add_arguments(parser, main)
    command_line.call(main, parser.parse_args(["a", "--prior", "b", "--", "c"]))
    assert (found["inputs"].prior, found["out"].prior) == (Path("b"), Path("c"))
