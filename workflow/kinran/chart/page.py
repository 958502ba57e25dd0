"""Write the page of all charts: for each fabric where the default stands, the chart, and its table.

The page is one file. A pointer over a method, in a chart or a table, picks it out everywhere.
"""

import argparse
from html import escape
from pathlib import Path

from kinran.chart import figure, front, rows
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
    ("microseconds", "µs", ".3g"),
    ("bytes", "bytes", ".4g"),
    ("memory_mb", "MB", ".0f"),
)
STYLE = """
body { margin: 0; background: #faf9f6; color: #2b2723; font: 15px/1.5 system-ui, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 28px 24px 80px; }
h1 { font: 600 34px/1.2 Georgia, serif; margin: 0; } h2 { font: 600 22px/1.3 Georgia, serif; margin: 40px 0 6px; }
p { max-width: 60em; } svg { max-width: 100%; height: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 3px 12px 3px 0; border-bottom: 1px solid #e4ddd3; }
th { color: #8a8178; font-weight: 500; } th:first-child, td:first-child { text-align: left; }
.faded [data-series]:not(.picked) { opacity: 0.12; } tr.picked { background: #f3e7c9; } tr.default { font-weight: 600; }
"""
SCRIPT = """
for (const part of document.querySelectorAll("section")) {
  const marks = [...part.querySelectorAll("[data-series]")];
  for (const mark of marks) {
    mark.addEventListener("mouseenter", () => {
      part.classList.add("faded");
      for (const m of marks) m.classList.toggle("picked", m.dataset.series === mark.dataset.series);
    });
    mark.addEventListener("mouseleave", () => {
      part.classList.remove("faded");
      for (const m of marks) m.classList.remove("picked");
    });
  }
}
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--charts", type=Path, nargs="+", required=True, help="tables of the fabrics (.csv)")
    parser.add_argument("out", type=Path, help="page (.html)")


def main(args: argparse.Namespace) -> None:
    """Write the page."""
    sections = "".join(section(rows.read(path)) for path in args.charts)
    page = (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Accuracy against speed · Kinran</title>'
        f"<style>{STYLE}</style></head><body><main><h1>Accuracy against speed</h1>"
        "<p>Every method sees the training lights alone and is judged on the same held-out lights. What a column"
        f" means stands in <code>docs/chart.md</code>.</p>{sections}</main><script>{SCRIPT}</script></body></html>\n"
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
        f"<section><h2>{escape(table[0].fabric)}</h2>{said}{figure.draw(table, heading=False).svg()}"
        f"<table><tr><th>method</th>{head}<th>on the front</th></tr>{body}</table></section>"
    )


def _line(row: Row, on_front: bool) -> str:
    cells = "".join(f"<td>{format(row[key], form) if row[key] == row[key] else ''}</td>" for key, _, form in COLUMNS)
    name = escape(row.method)
    kind = ' class="default"' if row.family == "default" else ""
    return f'<tr{kind} data-series="{name}"><td>{name}</td>{cells}<td>{"yes" if on_front else ""}</td></tr>'
