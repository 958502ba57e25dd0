"""The table of stability: the cases in which methods fail, and the remedies that hold there."""

from pathlib import Path
from typing import Any

from kinran.base.files import InputError, read_json

Values = dict[str, Any]

NEEDED = {
    "rows": {"case", "parameter", "method", "error"},
    "summary": {"case", "parameter", "fails", "error_failing", "holds", "error_holding"},
}
FAILED, HELD = 0.5, 0.2
"""Errors above which a method failed, and below which it held, for the colours of the table. Choices."""


def read(path: Path) -> Values:
    """Read rows and summary as `kinran bench stability` writes them; an error of None was not finite.

    Raises
    ------
    InputError
        The file is missing or is no such table.
    """
    value: Values = read_json(path)
    for name, keys in NEEDED.items():
        rows = value.get(name) if isinstance(value, dict) else None
        if not isinstance(rows, list) or not all(isinstance(row, dict) and keys <= row.keys() for row in rows):
            raise InputError(f"{path}: has no {name} of {', '.join(sorted(keys))}; make it by `kinran bench stability`")
    return value


def tables(value: Values) -> Values:
    """Values of the page: for each case a line of the summary, and a table with parameters down and methods across."""
    rows = value["rows"]
    cases = []
    for name in dict.fromkeys(row["case"] for row in rows):
        own = [row for row in rows if row["case"] == name]
        lines: dict[str, dict[str, float | None]] = {row["parameter"]: {} for row in own}
        for row in own:
            lines[row["parameter"]][row["method"]] = row["error"]
        methods = list(dict.fromkeys(row["method"] for row in own))
        cases.append({"name": name, "methods": methods, "lines": list(lines.items())})
    return {"summary": value["summary"], "cases": cases, "failed": FAILED, "held": HELD}
