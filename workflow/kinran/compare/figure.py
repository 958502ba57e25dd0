"""The chart as a drawing: error against cost, then over the amount of capture."""

import math
import textwrap

from kinran.base.drawing.canvas import FAINT, Canvas
from kinran.compare import front, panels
from kinran.compare.rows import Row

WIDTH, HEIGHT = panels.SIZE
PLATES = (
    ("microseconds", ""),
    ("bytes", ""),
    ("memory_mb", ""),
    ("microseconds", "log_error"),
    ("microseconds", "other"),
    ("microseconds", "ssim_display"),
)
"""Cost and measure of each panel. An empty measure is that by which the fabric is judged, PSNR or relative error;
``other`` is the other one of the two."""
SWEEPS = (
    ("directions", "relative_error", "Fewer lights", "number of light directions fitted, spread evenly", "number"),
    ("directions", "texels_above_1", "Fewer lights", "number of light directions fitted, spread evenly", "number"),
    ("exposures", "relative_error", "Fewer exposures", "exposures kept of each bracket, longest first", "number"),
    ("theta", "relative_error", "Between the lights", "θ of the judged light, all rings fitted", "band"),
    ("ring", "relative_error", "A ring left out", "ring of θ that was kept from the fit, and judged", "band"),
    ("extrapolation", "relative_error", "Beyond the lights", "θ of the judged light, fitted to θ ≤ 50° alone", "band"),
    ("region", "relative_error", "By region", "region of the fabric", "name"),
)
"""Experiment, measure, heading, label across, and kind of the settings of each panel."""


def draw(rows: list[Row], heading: bool = True) -> Canvas:
    """Draw all panels of a fabric, under the sentences on the default as a heading."""
    drawn = _panels(rows)
    words = [part for sentence in front.verdict(rows) for part in textwrap.wrap(sentence, 185)] if heading else []
    head = 58 + 18 * len(words) if heading else 0
    canvas = Canvas(2 * WIDTH + 20, head + HEIGHT * math.ceil(len(drawn) / 2) + 10)
    if heading:
        canvas.text((20, 32), f"{rows[0].fabric}: accuracy against speed, on held-out lights", size=20)
    for k, part in enumerate(words):
        canvas.text((20, 56 + 18 * k), part, colour=FAINT, size=13)
    for k, panel in enumerate(drawn):
        canvas.paste(panel, 10 + WIDTH * (k % 2), head + HEIGHT * (k // 2))
    return canvas


def _panels(rows: list[Row]) -> list[Canvas]:
    measure = front.judged(rows)
    other = "psnr_display" if measure == "relative_error" else "relative_error"
    measures = {"": measure, "other": other}
    drawn = [panels.against_cost(rows, cost, measures.get(name, name)) for cost, name in PLATES]
    swept = {row.method: row for row in rows if row.experiment == "directions"}
    names = sorted(swept, key=lambda name: (swept[name].family != "default", name))
    for experiment, name, heading, across, kind in SWEEPS:
        some = [row for row in rows if row.experiment == experiment and row.method in swept]
        if some:
            drawn.append(panels.over_settings(some, name, heading, across, kind, names))
    regions = [row for row in rows if row.experiment == "segmentation"]
    if regions:
        drawn.append(panels.wrong_labels(regions))
    return [panel for panel in drawn if panel]
