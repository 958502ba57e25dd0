"""The table of stability: where each method fails, and what holds there."""

from html import escape
from pathlib import Path
from typing import Any

from kinran.files import InputError, read_json

Values = dict[str, Any]

NEEDED = {
    "rows": {"case", "parameter", "method", "error"},
    "summary": {"case", "parameter", "fails", "error_failing", "holds", "error_holding"},
}
FAILED, HELD = 0.5, 0.2
"""Errors over the one are failures, and under the other held, for the colours of the table."""
INTRODUCTION = (
    "Synthetic texels on the paper's grid, made worse from row to row. Errors are relative, on lights kept from fits:"
    " the median over texels, or what the case says. First, for each case, where the method that fails is furthest"
    " from the one that holds. Red: over 0.5, the fit is of no use. Green: under 0.2."
)
STYLE = """
.stable { columns: 2 560px; column-gap: 40px; } .stable table { break-inside: avoid; margin-bottom: 16px; width: 100%; }
.stable th { max-width: 150px; } caption { text-align: left; font-weight: 600; padding: 6px 0 2px; }
td.failed { background: #f4d9d3; } td.held { background: #dfead9; } .word { text-align: left; padding-left: 18px; }
"""


def read(path: Path) -> Values:
    """Rows and summary as `kinran bench stability` writes them; an error of None is no number.

    Raises
    ------
    InputError
        The file is no such table.
    """
    value: Values = read_json(path)
    for name, keys in NEEDED.items():
        rows = value.get(name) if isinstance(value, dict) else None
        if not isinstance(rows, list) or not all(isinstance(row, dict) and keys <= row.keys() for row in rows):
            raise InputError(f"{path}: has no {name} of {', '.join(sorted(keys))}; make it by `kinran bench stability`")
    return value


def section(value: Values) -> str:
    """Markup: a line a case, and in a fold a table a case with its parameter down and methods across."""
    lines = "".join(
        f"<tr><td>{escape(row['case'])}, {escape(row['parameter'])}</td>"
        f'<td class="word">{escape(row["fails"])}</td>{_cell(row["error_failing"])}'
        f'<td class="word">{escape(row["holds"])}</td>{_cell(row["error_holding"])}</tr>'
        for row in value["summary"]
    )
    rows = value["rows"]
    cases = "".join(_case(name, [row for row in rows if row["case"] == name]) for name in _unique(rows, "case"))
    return (
        f'<section class="stability"><h2>Where methods fail</h2><p>{INTRODUCTION}</p>'
        '<table><tr><th>case</th><th class="word">fails</th><th>error</th><th class="word">holds</th><th>error</th>'
        f"</tr>{lines}</table><details><summary>All cases and methods</summary>"
        f'<div class="stable">{cases}</div></details></section>'
    )


def _unique(rows: list[Values], key: str) -> list[str]:
    return list(dict.fromkeys(row[key] for row in rows))


def _case(name: str, rows: list[Values]) -> str:
    methods = _unique(rows, "method")
    found = {(row["parameter"], row["method"]): row["error"] for row in rows}
    head = "".join(f"<th>{escape(method)}</th>" for method in methods)
    lines = ""
    for parameter in _unique(rows, "parameter"):
        cells = (_cell(found[parameter, m]) if (parameter, m) in found else "<td></td>" for m in methods)
        lines += f"<tr><td>{escape(parameter)}</td>{''.join(cells)}</tr>"
    return f"<table><caption>{escape(name)}</caption><tr><th></th>{head}</tr>{lines}</table>"


def _cell(error: float | None) -> str:
    if error is None:
        return '<td class="failed">not finite</td>'
    kind = ' class="failed"' if error > FAILED else ' class="held"' if error < HELD else ""
    return f"<td{kind}>{error:.3f}</td>"
