"""Join the tables of a fabric's methods, draw the chart, and log the place of the default."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.drawing import canvas
from kinran.compare import figure, front, rows
from kinran.compare.rows import Row

log = logging.getLogger(__name__)

FAMILIES = ("default", "kinran", "paper", "baseline")


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    tables: Annotated[tuple[Path, ...], "tables of the methods (.csv)"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    out: Annotated[Path, "OUT", "table (.csv)"]
    pictures: Annotated[tuple[Path, ...], "the chart as .svg and .png"] = ()


def main(inputs: Inputs, out: Outputs) -> None:
    """Write the table and the pictures."""
    write(out.out, [row for path in inputs.tables for row in rows.read(path)], out.pictures)


def write(path: Path, table: list[Row], pictures: Sequence[Path]) -> None:
    """Write rows in order with one floor, and their chart; log the place of the default."""
    table = joined(table)
    rows.write(path, table)
    for picture in pictures:
        canvas.write(picture, figure.draw(table))
    for sentence in front.verdict(table):
        log.info(sentence)


def joined(table: list[Row]) -> list[Row]:
    """Order rows by experiment, by family and by bytes of the method, and keep the least of the floors.

    The floor is measured by every job: the least is that of the quietest moment.
    """
    floors = [row for row in table if row.experiment == "floor"]
    size = {row.method: row["bytes"] for row in table if row.experiment == "all"}
    order = list(dict.fromkeys(row.experiment for row in table))

    def place(row: Row) -> tuple[int, int, float, str]:
        family = FAMILIES.index(row.family) if row.family in FAMILIES else len(FAMILIES)
        return order.index(row.experiment), family, size.get(row.method, 0.0), row.method

    return [
        *sorted(floors, key=lambda row: row["microseconds"])[:1],
        *sorted((row for row in table if row.experiment != "floor"), key=place),
    ]
