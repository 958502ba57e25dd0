"""Sheets of text: a header, then one row for each item, with cells between tabs or commas."""

import csv
from dataclasses import dataclass
from pathlib import Path

from kinran.base.files import InputError


@dataclass(frozen=True)
class Row:
    """A row of a sheet.

    Attributes
    ----------
    line
        Number of its line.
    cells
        Its cells by column.
    wrong
        What is wrong with it, in a sentence: it has another number of cells than the header. Empty where nothing is.
    """

    line: int
    cells: dict[str, str]
    wrong: str


def each_row(path: str | Path, commas: bool = False) -> list[Row]:
    """Return the rows of a sheet, also those that have another number of cells than the header.

    Lines that are empty or start with # are left out.

    Parameters
    ----------
    path
        The sheet.
    commas
        Whether cells may stand between commas, where the header has no tab.

    Raises
    ------
    InputError
        The sheet is missing.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a tab-separated sheet") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    between = "," if commas and lines and "\t" not in lines[0][1] else "\t"
    cells = [(number, [cell.strip() for cell in next(csv.reader([line], delimiter=between))]) for number, line in lines]
    header = cells[0][1] if cells else []
    use = "commas" if between == "," else "tabs"
    rows = []
    for number, row in cells[1:]:
        wrong = f"{path}: line {number} has another number of cells than the header; use {use}"
        rows.append(Row(number, dict(zip(header, row, strict=False)), wrong if len(row) != len(header) else ""))
    return rows


def numbered_rows(path: str | Path, commas: bool = False) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a sheet, as text by column, each with the number of its line; parameters as in `each_row`.

    Raises
    ------
    InputError
        The sheet is missing, or a row has another number of cells than the header.
    """
    rows = each_row(path, commas)
    for row in rows:
        if row.wrong:
            raise InputError(row.wrong)
    return [(row.line, row.cells) for row in rows]
