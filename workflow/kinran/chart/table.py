"""Join the tables of a fabric's methods, draw them, and say where the default stands."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from kinran import canvas
from kinran.chart import figure, front, rows
from kinran.chart.rows import Row

FAMILIES = ("default", "kinran", "paper", "baseline")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--tables", type=Path, nargs="+", required=True, help="of the methods (.csv)")
    parser.add_argument("--pictures", type=Path, nargs="+", default=[], help="the chart as .svg and .png")
    parser.add_argument("out", type=Path, help="table (.csv)")


def main(args: argparse.Namespace) -> None:
    """Write the table and the pictures."""
    write(args.out, [row for path in args.tables for row in rows.read(path)], args.pictures)


def write(path: Path, table: list[Row], pictures: Sequence[Path]) -> None:
    """Write rows in order with one floor, and their chart; say on stderr where the default stands."""
    table = joined(table)
    rows.write(path, table)
    for picture in pictures:
        canvas.write(picture, figure.draw(table))
    for sentence in front.verdict(table):
        print(sentence, file=sys.stderr)


def joined(table: list[Row]) -> list[Row]:
    """Rows by experiment as they came, families and their methods from the smallest on; the least of the floors.

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
