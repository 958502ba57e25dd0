"""The digest changes with code and with nothing else."""

from pathlib import Path

import pytest

from kinran.base import digest

A = """\"\"\"What a does.\"\"\"

from typing import TYPE_CHECKING, Annotated

from p import b

if TYPE_CHECKING:
    from p import d

SIZE: Annotated[int, "SIZE", "of it"] = 3
\"\"\"Of it.\"\"\"


def f(d: "d.D"):
    \"\"\"Sum.\"\"\"
    from p.c import g

    return b.x + g
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "p"
    (folder / "q").mkdir(parents=True)
    (folder / "__init__.py").write_text("")
    (folder / "a.py").write_text(A)
    (folder / "b.py").write_text("from p.q import e\n\nx = e.y\n")
    (folder / "c.py").write_text("from p.q import g\n")
    (folder / "d.py").write_text("y = 3\n")
    (folder / "q" / "__init__.py").write_text("g = 2\n")
    (folder / "q" / "e.py").write_text("y = 1\n")
    monkeypatch.setattr(digest, "PACKAGES", {"p": folder})
    return folder


def fresh(module: str) -> str:
    digest.digest.cache_clear()
    digest._read.cache_clear()
    return digest.digest(module)


def replaced(old: str, new: str) -> str:
    """Text of module a with a part replaced."""
    assert old in A
    return A.replace(old, new)


@pytest.mark.parametrize(
    ("file", "text", "changes"),
    [
        ("a.py", replaced("    return b.x", "    # a comment\n    return (b.x)"), False),
        ("a.py", replaced("    return b.x", "    return 2 * b.x"), True),
        ("b.py", "from p.q import e  # one\nx = e.y\n", False),
        ("b.py", "from p.q import e\n\nx = e.y + 1\n", True),
        ("q/e.py", "y = 2\n", True),
    ],
)
def test_code_counts(package: Path, file: str, text: str, changes: bool) -> None:
    before = fresh("p.a")
    (package / file).write_text(text)
    assert (fresh("p.a") != before) == changes


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("What a does.", "What it does."),
        ("Sum.", "Sum\n\n    of both."),
        ('    """Sum."""\n', ""),
        ('\n"""Of it."""', ""),
        ('"SIZE", "of it"', '"SIZE", "of everything"'),
    ],
)
def test_docstrings_and_help_do_not_count(package: Path, old: str, new: str) -> None:
    before = fresh("p.a")
    (package / "a.py").write_text(replaced(old, new))
    assert fresh("p.a") == before


def test_a_string_that_is_used_counts(package: Path) -> None:
    (package / "d.py").write_text('y = "one"\n')
    before = fresh("p.d")
    (package / "d.py").write_text('y = "two"\n')
    assert fresh("p.d") != before


def test_imports_for_types_alone_do_not_count(package: Path) -> None:
    before = fresh("p.a")
    (package / "d.py").write_text("y = 4\n")
    assert fresh("p.a") == before
    (package / "a.py").write_text(replaced("if TYPE_CHECKING:\n    from p import d\n", ""))
    assert fresh("p.a") == before
    (package / "a.py").write_text(replaced("if TYPE_CHECKING:\n    from p import d\n", "from p import d\n"))
    assert fresh("p.a") != before


def test_a_package_counts_where_a_name_is_taken_from_it(package: Path) -> None:
    """One through which an import leads does not."""
    before = fresh("p.b"), fresh("p.c")
    (package / "q" / "__init__.py").write_text("g = 3\n")
    after = fresh("p.b"), fresh("p.c")
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_templates_count_where_they_are_named(package: Path) -> None:
    """By a module, or by a template that a module names; in a docstring a name is a mention alone."""
    (package / "d.py").write_text('"""No "other.html"."""\n\npage = "one.html"\n')
    for name, text in (("one", '{% extends "base.html" %}'), ("base", "<p>"), ("other", "<p>")):
        (package / f"{name}.html").write_text(text)
    before = fresh("p.d")
    (package / "other.html").write_text("<b>")
    assert fresh("p.d") == before
    (package / "base.html").write_text("<b>")
    assert fresh("p.d") != before


def test_what_is_beside_does_not_count(package: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither what a caller names, nor what never counts, nor what only they import."""
    monkeypatch.setattr(digest, "BESIDE", frozenset({"p.c"}))
    assert digest.modules("p.a") == ["p.a", "p.b", "p.q.e"]
    assert digest.modules("p.a", "p.b") == ["p.a"]
    before = fresh("p.a"), digest.digest("p.a", "p.b")
    (package / "c.py").write_text("from p.q import g\n\nz = g\n")
    (package / "q" / "__init__.py").write_text("g = 4\n")
    assert (fresh("p.a"), digest.digest("p.a", "p.b")) == before
    (package / "q" / "e.py").write_text("y = 5\n")
    assert fresh("p.a") != before[0]
    assert digest.digest("p.a", "p.b") == before[1]


def test_what_never_counts_is_there() -> None:
    assert all(digest._file(name) for name in digest.BESIDE)


@pytest.mark.parametrize("names", [["kinran.none"], ["kinran.fit.fit", "kinran.none"]])
def test_unknown_module(names: list[str]) -> None:
    with pytest.raises(ModuleNotFoundError):
        digest.digest(*names)


def test_every_stage_has_one() -> None:
    stages = ("kinran.bracket.merge", "kinran.segment.segment", "kinran.fit.fit", "kinran.report.report")
    assert len({digest.digest(stage) for stage in stages}) == 4
