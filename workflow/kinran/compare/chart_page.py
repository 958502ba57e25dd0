"""Write the page of all charts: for each fabric the place of the default, the chart and its table.

The page is one file that needs no network. A pointer over a method, in a chart or a table, picks it out everywhere
and says its values.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from kinran.base.page import write_page
from kinran.compare import figure, front, panels, rows, stability
from kinran.compare.rows import Row

COLUMNS = (
    ("relative_error", "relative error", ".3f"),
    ("log_error", "log error", ".3f"),
    ("texel_p95", "95 % of texels", ".3f"),
    ("texels_above_1", "above 1", ".2%"),
    ("psnr_display", "PSNR, dB", ".2f"),
    ("psnr_linear", "linear", ".2f"),
    ("ssim_display", "SSIM", ".4f"),
    ("ssim_linear", "linear", ".4f"),
    ("microseconds", "µs", ""),
    ("bytes", "bytes", ""),
    ("memory_mb", "MB", ".0f"),
    ("peak_mb", "process, MB", ".0f"),
    ("aic", "AIC", ".0f"),
    ("bic", "BIC", ".0f"),
)
EXPLORER = (1290, 520)
"""Width and height, in pixels, of the plot whose axes a reader chooses."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    charts: Annotated[tuple[Path, ...], "tables of the fabrics (.csv)"]
    stability: Annotated[Path | None, "table of `kinran bench stability` (.json)"] = None


def main(inputs: Inputs, out: Annotated[Path, "OUT", "page (.html)"]) -> None:
    """Write the page."""
    values = {
        "title": "Accuracy against speed",
        "head": [title for _, title, _ in COLUMNS],
        "costs": panels.COSTS,
        "measures": {name: title for name, title in panels.MEASURES.items() if name != "texels_above_1"},
        "fabrics": [fabric(rows.read(path)) for path in inputs.charts],
        "stability": stability.tables(stability.read(inputs.stability)) if inputs.stability else None,
    }
    write_page(out, Path(__file__).with_name("charts.html"), values)


def fabric(table: list[Row]) -> dict[str, Any]:
    """Values of one fabric's part of the page: a plot for each cost and measure, all panels, and the table."""
    measure = front.judged(table)
    whole = sorted((row for row in table if row.experiment == "all"), key=lambda row: front.error(row, measure))
    return {
        "name": table[0].fabric,
        "verdict": front.verdict(table),
        "judged": measure,
        "plots": {
            (cost, name): canvas.svg(f"{panels.MEASURES[name]} against {panels.COSTS[cost]}")
            for cost in panels.COSTS
            for name in panels.MEASURES
            if (canvas := panels.against_cost(table, cost, name, EXPLORER))
        },
        "figure": figure.draw(table, heading=False).svg("Error against what it costs, and against what was captured"),
        "methods": [
            {
                "name": row.method,
                "default": row.family == "default",
                "cells": [_number(row[key], form) for key, _, form in COLUMNS],
                "front": not front.beaten_by(whole, row, measure),
            }
            for row in whole
        ],
    }


def _number(value: float, form: str) -> str:
    """Format a number, by default with three figures and no exponent; empty for NaN."""
    if math.isnan(value):
        return ""
    if form:
        return format(value, form)
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 0.01 else "0"
