"""The Pareto front of methods in time, bytes and error, and the place of the default."""

import math
from collections.abc import Sequence

from kinran.compare.rows import Row

SLACK = (1.15, 1.1, 1.02)
"""Factors of time, bytes and error within which two methods are equal: times vary by as much from run to run."""
CLEAR = (1.5, 1.25, 1.05)
"""Factors of time, bytes and error from which one method is clearly better. Choices."""


def beats(row: Sequence[float], other: Sequence[float]) -> bool:
    """Whether a row (time, bytes, error) is nowhere worse than another and clearly better in something."""
    pairs = list(zip(row, other, strict=True))
    nowhere_worse = all(a <= b * slack for (a, b), slack in zip(pairs, SLACK, strict=True))
    return nowhere_worse and any(a * clear < b for (a, b), clear in zip(pairs, CLEAR, strict=True))


def judged(rows: list[Row]) -> str:
    """Measure that a fabric is judged by: PSNR of display values for photographs, relative error for radiance."""
    return next((row.setting for row in rows if row.experiment == "floor"), "") or "relative_error"


def error(row: Row, measure: str) -> float:
    """Error of a row, smaller being better; of a PSNR the root mean square error of the display values."""
    return float(10 ** (-row[measure] / 20)) if measure.startswith("psnr") else row[measure]


def beaten_by(whole: list[Row], row: Row, measure: str) -> list[Row]:
    """Rows that beat a row in time, bytes and the error of a measure."""

    def axes(one: Row) -> tuple[float, float, float]:
        return one["microseconds"], one["bytes"], error(one, measure)

    return [other for other in whole if other is not row and beats(axes(other), axes(row))]


def line(points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points of a cost-error plot of which none is both cheaper and better, by cost."""
    result: list[tuple[float, float]] = []
    for cost, error in sorted(points):
        if not result or error < result[-1][1]:
            result.append((cost, error))
    return result


def verdict(rows: list[Row]) -> list[str]:
    """Sentences on the place of the default in the chart.

    Parameters
    ----------
    rows
        All rows of a fabric.
    """
    whole = [row for row in rows if row.experiment == "all"]
    floor = next((row["microseconds"] for row in rows if row.experiment == "floor"), math.nan)
    measure, sentences = judged(rows), []
    for row in (row for row in whole if row.family == "default"):
        worse = beaten_by(whole, row, measure)
        better = sum(error(other, measure) * SLACK[2] < error(row, measure) for other in whole)
        value = row[measure]
        reached = f"{value:.1f} dB" if measure.startswith("psnr") else f"relative error {value:.3f}"
        place = (
            f"{row.method}: {reached}, {row['microseconds']:.3g} µs and"
            f" {row['bytes']:.3g} bytes a texel, {row['microseconds'] / floor:.0f} times the floor of reading the"
            f" samples once; {better} of {len(whole) - 1} other methods are more accurate."
        )
        if worse:
            names = ", ".join(f"{other.method} ({_how_far(other, row, measure)})" for other in worse)
            place += f" It is not on the front: {names}; each is as accurate, no dearer and better in something."
        else:
            place += " It is on the front: none that is as accurate is as fast and as small."
        sentences.append(place)
    return sentences


def _how_far(other: Row, row: Row, measure: str) -> str:
    """Factors of error, time and bytes between a row and the one that it beats, in words."""
    parts = (
        ("error", error(other, measure) / error(row, measure)),
        ("time", other["microseconds"] / row["microseconds"]),
        ("bytes", other["bytes"] / row["bytes"]),
    )
    return ", ".join(f"{factor:.2g} of its {name}" for name, factor in parts)
