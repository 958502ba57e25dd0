"""Files appear whole or not at all."""

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from kinran.base.files import InputError, atomic, check_name, read_as, read_json, sha256, write_json


@dataclass(frozen=True)
class Spool:
    """A dataclass with what JSON does not tell apart: a tuple and a whole number."""

    name: str
    colour: tuple[float, float, float]
    turns: int | None = None


def test_nothing_is_left_when_writing_fails(tmp_path: Path) -> None:
    target = tmp_path / "a.json"
    target.write_text("old")

    def fail() -> None:
        with atomic(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError("in the middle")

    with pytest.raises(RuntimeError, match="in the middle"):
        fail()
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]


def test_json_round_trip_and_no_nan(tmp_path: Path) -> None:
    write_json(tmp_path / "deep" / "a.json", {"θ": [1, 2.5, None]})
    assert read_json(tmp_path / "deep" / "a.json") == {"θ": [1, 2.5, None]}
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "b.json", float("nan"))
    assert not (tmp_path / "b.json").exists()


def test_bad_json(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(InputError, match="not valid JSON"):
        read_json(tmp_path / "a.json")
    with pytest.raises(InputError, match="no such file"):
        read_json(tmp_path / "none.json")


def test_dataclasses_round_trip(tmp_path: Path) -> None:
    spools = [Spool("gold", (0.9, 0.7, 0.3), 3), Spool("red", (1.0, 0.0, 0.0))]
    write_json(tmp_path / "a.json", spools)
    assert read_json(tmp_path / "a.json")[1] == {"name": "red", "colour": [1.0, 0.0, 0.0], "turns": None}
    assert read_as(tmp_path / "a.json", list[Spool], "a list of spools") == spools


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{}", r"a\.json: is not a list of spools \(Expected `array`, got `object`\); wind it again$"),
        ('[{"name": "red"}]', r"a\.json: is not .* \(\[0\]: Object missing required field `colour`\)"),
        ('[{"name": 1, "colour": [1, 0, 0]}]', r"a\.json: is not .* \(\[0\]\.name: Expected `str`, got `int`\)"),
        ('[{"name": "red", "colour": [1, 0]}]', r"a\.json: is not .* \(\[0\]\.colour: Expected `array` of length 3"),
    ],
)
def test_a_dataclass_that_is_none_is_named_with_its_field(tmp_path: Path, text: str, says: str) -> None:
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(InputError, match=says):
        read_as(tmp_path / "a.json", list[Spool], "a list of spools", "wind it again")


def test_a_file_where_a_folder_should_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        write_json(tmp_path / "file" / "a.json", 1)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission_is_named(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(InputError, match="choose another output folder"):
        write_json(tmp_path / "a.json", 1)


@pytest.mark.parametrize("name", ["brocade", "n-1_b", "0"])
def test_good_names(name: str) -> None:
    assert check_name(name, "fabric") == name


@pytest.mark.parametrize("name", ["", "../x", "a/b", "<b>", "A", "-a", "a b", "a;b", "é", ".", "a\n"])
def test_names_that_are_paths_markup_or_shell_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="use only a-z, 0-9, _ and -"):
        check_name(name, "fabric")


def test_sha256(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert sha256(tmp_path / "a").startswith("ba7816bf8f01cfea")
