"""The digest changes with code and with nothing else."""

from pathlib import Path

import pytest

from kinran import code


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "p"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "a.py").write_text("from p import b\n\ndef f():\n    from p.c import g\n    return b.x + g\n")
    (folder / "b.py").write_text("x = 1\n")
    (folder / "c.py").write_text("g = 2\n")
    (folder / "d.py").write_text("y = 3\n")
    monkeypatch.setattr(code, "PACKAGES", {"p": folder})
    return folder


def fresh(module: str) -> str:
    code.digest.cache_clear()
    code._read.cache_clear()
    return code.digest(module)


@pytest.mark.parametrize(
    ("file", "text", "changes"),
    [
        (
            "a.py",
            "# a comment\nfrom p import b\n\n\ndef f():\n  from p.c import g\n  return b.x + g\n",
            False,
        ),
        ("b.py", "x = 1  # one\n", False),
        ("b.py", "x = 2\n", True),
        ("c.py", "g = 3\n", True),
        ("d.py", "y = 4\n", False),
    ],
)
def test_what_changes_it(package: Path, file: str, text: str, changes: bool) -> None:
    before = fresh("p.a")
    (package / file).write_text(text)
    assert (fresh("p.a") != before) == changes


def test_unknown_module() -> None:
    with pytest.raises(ModuleNotFoundError):
        code.digest("kinran.none")


def test_every_stage_has_one() -> None:
    assert len({code.digest(f"kinran.{m}") for m in ("radiance.merge", "segment", "fit.tile", "report")}) == 4
