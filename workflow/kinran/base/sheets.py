"""Sheets of text: a header, then one row for each item, with cells between tabs or commas."""

import csv
from pathlib import Path

from kinran.base.files import InputError


def numbered_rows(path: str | Path, commas: bool = False) -> list[tuple[int, dict[str, str]]]:
    """Return the rows of a sheet, as text by column, each with the number of its line.

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
        The sheet is missing, or a row has another number of cells than the header.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a tab-separated sheet") from None
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip() and line[0] != "#"]
    between = "," if commas and lines and "\t" not in lines[0][1] else "\t"
    cells = [(number, [cell.strip() for cell in next(csv.reader([line], delimiter=between))]) for number, line in lines]
    header = cells[0][1] if cells else []
    for number, row in cells:
        if len(row) != len(header):
            use = "commas" if between == "," else "tabs"
            raise InputError(f"{path}: line {number} has another number of cells than the header; use {use}")
    return [(number, dict(zip(header, row, strict=True))) for number, row in cells[1:]]


def read_sheet(path: str | Path) -> list[dict[str, str]]:
    """Return the rows of a tab-separated sheet, as text by column; errors are those of `numbered_rows`."""
    return [row for _, row in numbered_rows(path)]
