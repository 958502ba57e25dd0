"""Tab-separated sheets: a header, then one row for each item."""

import csv
from pathlib import Path

from kinran.base.files import InputError


def read_sheet(path: str | Path) -> list[dict[str, str]]:
    """Rows of a sheet, as text by column; lines that are empty or start with # are left out.

    Raises
    ------
    InputError
        The sheet is missing, or a row has another number of cells than the header.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read ({error}); give a tab-separated sheet") from None
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    rows = []
    for number, row in enumerate(csv.DictReader(lines, delimiter="\t"), 2):
        if None in row or None in row.values():
            raise InputError(f"{path}: row {number} has another number of cells than the header; use tabs")
        rows.append({key: value.strip() for key, value in row.items()})
    return rows
