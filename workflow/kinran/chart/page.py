"""Write the page of all charts: for each fabric where the default stands, the chart, and its table.

The page is one file that needs no network. A pointer over a method, in a chart or a table, picks it out everywhere
and says its values.
"""

import argparse
import math
from html import escape
from pathlib import Path

from kinran.chart import explorer, figure, front, rows, stability
from kinran.chart.rows import Row
from kinran.files import atomic

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
STYLE = """
body { margin: 0; background: #faf9f6; color: #2b2723; font: 15px/1.5 system-ui, sans-serif; }
main { max-width: 1380px; margin: 0 auto; padding: 28px 24px 80px; }
h1 { font: 600 34px/1.2 Georgia, serif; margin: 0; } h2 { font: 600 24px/1.3 Georgia, serif; margin: 44px 0 6px; }
h3 { font: 600 17px/1.3 Georgia, serif; margin: 22px 0 4px; }
p { max-width: 68em; } svg { max-width: 100%; height: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 3px 12px 3px 0; border-bottom: 1px solid #e4ddd3; }
th { color: #6d655c; font-weight: 500; } th:first-child, td:first-child { text-align: left; }
.faded [data-series]:not(.picked) { opacity: 0.12; } tr.picked { background: #f3e7c9; } tr.default { font-weight: 600; }
"""
INTRODUCTION = (
    "Every method sees the training lights alone and is judged on the same held-out lights. Down and to the left is"
    " better; of PSNR and SSIM, up and to the left. The ring is the default: the material that the pipeline wrote."
    " Filled dots lie on the front of their panel, to which no fit is both cheaper and better; interpolation, which has"
    " no fit, counts by its bytes alone. Point at a dot, a line or a row to see its values and to pick the method out"
    " everywhere."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--charts", type=Path, nargs="+", required=True, help="tables of the fabrics (.csv)")
    parser.add_argument("--stability", type=Path, help="where methods fail, of `kinran bench stability` (.json)")
    parser.add_argument("out", type=Path, help="page (.html)")


def main(args: argparse.Namespace) -> None:
    """Write the page."""
    sections = "".join(section(rows.read(path)) for path in args.charts)
    stable = stability.section(stability.read(args.stability)) if args.stability else ""
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Accuracy against speed · Kinran</title>'
        f"<style>{STYLE}{explorer.STYLE}{stability.STYLE}</style></head>"
        f"<body><main><h1>Accuracy against speed</h1><p>{INTRODUCTION}</p>{sections}{stable}"
        "<p>What a column means, and how it was measured, stands in <code>docs/chart.md</code>.</p>"
        f"</main><script>{explorer.SCRIPT}</script></body></html>\n"
    )
    with atomic(args.out) as temporary:
        temporary.write_text(page, encoding="utf-8")


def section(table: list[Row]) -> str:
    """Markup of one fabric."""
    said = "".join(f"<p>{escape(sentence)}</p>" for sentence in front.verdict(table))
    head = "".join(f"<th>{escape(title)}</th>" for _, title, _ in COLUMNS)
    measure = front.judged(table)
    whole = sorted((row for row in table if row.experiment == "all"), key=lambda row: front.error(row, measure))
    body = "".join(_line(row, not front.beaten_by(whole, row, measure)) for row in whole)
    return (
        f"<section><h2>{escape(table[0].fabric)}</h2>{said}{explorer.markup(table, measure)}"
        f"{figure.draw(table, heading=False).svg()}"
        f"<table><tr><th>method</th>{head}<th>on the front</th></tr>{body}</table></section>"
    )


def _line(row: Row, on_front: bool) -> str:
    cells = "".join(f"<td>{_number(row[key], form)}</td>" for key, _, form in COLUMNS)
    name = escape(row.method)
    kind = ' class="default"' if row.family == "default" else ""
    return f'<tr{kind} data-series="{name}"><td>{name}</td>{cells}<td>{"yes" if on_front else ""}</td></tr>'


def _number(value: float, form: str) -> str:
    """A number in its form, by default three figures without an exponent; nothing for none."""
    if math.isnan(value):
        return ""
    if form:
        return format(value, form)
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 0.01 else "0"
