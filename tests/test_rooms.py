"""The house: which room imports which, drawn from the imports. `python tests/test_rooms.py` prints the plan.

A room is a folder of the library with the modules in it. A room stands on a floor and imports rooms of lower floors
alone: so no arrow runs back, and no circle closes. A new folder needs a place in `FLOORS`.
"""

import ast
from pathlib import Path

import pytest

from kinran.__main__ import ALL
from kinran.base import digest

FLOORS: tuple[tuple[str, ...], ...] = (
    ("plugin", "base"),
    ("base.drawing", "data", "rig", "fit.solver"),
    ("virtual", "bracket", "segment", "register", "fit", "scene"),
    ("capture", "calibrate", "compare.baselines"),
    ("radiance", "judge", "compare", "report", "run"),
)
"""Rooms from the ground up; in a floor in the order of the data."""
WITHIN = {"compare.methods": "compare"}
"""Folders that are no rooms of their own: a kind of method is a file there, which the room finds by its name."""
WITH_CODE = {"kinran", "kinran.fit.solver", "kinran.compare.methods"}
"""Packages whose `__init__` is more than a docstring: it keeps compiled code, or lists the modules beside it."""

Arrows = dict[tuple[str, str], list[str]]


def modules() -> dict[str, Path]:
    """Modules of the library and the plugin by their names; packages by theirs."""
    found = {}
    for package in ("kinran", "kinran_bsdf"):
        folder = digest.PACKAGES[package]
        for path in sorted(folder.rglob("*.py")):
            parts = (package, *path.relative_to(folder).with_suffix("").parts)
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


MODULES = modules()


def room(module: str) -> str:
    """Room of a module: its folder, `plugin`, or nothing for the package itself and its door."""
    if module.startswith("kinran_bsdf"):
        return "plugin"
    package = module if MODULES[module].name == "__init__.py" else module.rpartition(".")[0]
    folder = package.removeprefix("kinran").removeprefix(".")
    return WITHIN.get(folder, folder)


def arrows() -> Arrows:
    """Pairs of rooms of which the first imports the second, each with the imports that say so."""
    found: Arrows = {}
    for module in MODULES:
        for other in digest.imports(module):
            if room(module) and room(other) and room(module) != room(other):
                found.setdefault((room(module), room(other)), []).append(f"{module} imports {other}")
    return found


def floor(name: str) -> int:
    """Floor of a room, from 1."""
    return next(k for k, rooms in enumerate(FLOORS, 1) if name in rooms)


def plan() -> str:
    """The house in words: each floor from the top, its rooms, and what they import."""
    drawn = arrows()
    lines = [f"{sum(map(len, FLOORS))} rooms, {len(FLOORS)} floors, {len(drawn)} arrows"]
    for k in range(len(FLOORS), 0, -1):
        for name in FLOORS[k - 1]:
            below = ", ".join(sorted(b for a, b in drawn if a == name))
            count = sum(room(module) == name for module in MODULES)
            lines.append(f"{k}  {name:<18} {count:>3} modules  {'imports ' + below if below else ''}".rstrip())
    return "\n".join(lines)


def test_every_room_has_a_floor() -> None:
    stands = [name for rooms in FLOORS for name in rooms]
    assert len(stands) == len(set(stands))
    assert {room(module) for module in MODULES} - {""} == set(stands)


def test_no_arrow_runs_back() -> None:
    print("\n" + plan())
    back = [
        f"{a} (floor {floor(a)}) imports {b} (floor {floor(b)}): {line}"
        for (a, b), lines in arrows().items()
        if floor(a) <= floor(b)
        for line in lines
    ]
    assert back == []


def test_no_circle_of_modules() -> None:
    """Inside a room too, a module imports none that imports it in turn."""
    below: dict[str, set[str]] = {}

    def visit(module: str, way: tuple[str, ...]) -> set[str]:
        assert module not in way, " → ".join((*way[way.index(module) :], module))
        if module not in below:
            further = [visit(other, (*way, module)) for other in sorted(set(digest.imports(module)))]
            below[module] = {module}.union(*further)
        return below[module]

    for module in MODULES:
        visit(module, ())


def test_no_stage_is_imported() -> None:
    """What a stage shares with others is a noun below both: so a digest holds what a stage runs, and nothing else."""
    stages = {module for module, *_ in ALL.values() if module.startswith("kinran.")}
    assert [f"{a} imports {b}" for a in MODULES for b in digest.imports(a) if b in stages - {a}] == []


@pytest.mark.parametrize("command", ALL)
def test_a_command_is_in_the_file_of_its_name(command: str) -> None:
    """And no other file of the library has that name."""
    name = command.replace("-", "_")
    package = ALL[command][0].partition(".")[0]
    files = [m for m in MODULES if m.partition(".")[0] == package and m.rpartition(".")[2] == name]
    rooms = {module for module in files if MODULES[module].name == "__init__.py"} - {ALL[command][0]}
    assert set(files) - rooms == {ALL[command][0]}


def test_rooms_hold_no_code_of_their_own() -> None:
    """An `__init__` is a docstring: what a digest does not hold cannot change what a stage does (`base/digest.py`)."""
    for module, path in MODULES.items():
        if path.name == "__init__.py" and module.startswith("kinran") and "bsdf" not in module:
            code = [line for line in ast.parse(path.read_text(encoding="utf-8")).body if not isinstance(line, ast.Expr)]
            assert module in WITH_CODE or code == [], module


if __name__ == "__main__":
    print(plan())
