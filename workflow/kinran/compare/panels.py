"""Panels of the chart: error against cost, error over the amount of capture, wrong labels."""

import math
from collections.abc import Sequence

from kinran.base.drawing import axes, plots
from kinran.base.drawing.axes import LEFT
from kinran.base.drawing.canvas import FAINT, Canvas
from kinran.compare import front
from kinran.compare.rows import Row

SIZE = (680, 480)
"""Width and height of a panel, in pixels."""
COSTS = {
    "microseconds": "processor time of the fit, µs a texel",
    "bytes": "size of the result, bytes a texel",
    "memory_mb": "memory of the fit above its samples, MB",
}
MEASURES = {
    "relative_error": "relative error on held-out lights",
    "log_error": "mean |log error| on held-out lights: dark counts as much as bright",
    "psnr_display": "PSNR of display values, dB (higher is better)",
    "psnr_linear": "PSNR of linear values, dB (higher is better)",
    "ssim_display": "SSIM of display values (higher is better)",
    "ssim_linear": "SSIM of linear values (higher is better)",
    "texels_above_1": "share of texels with an error over 1",
}
LEAST = {"microseconds": 0.02, "bytes": 1.0, "memory_mb": 1.0}
"""Costs below these are drawn at the left edge."""
FAMILIES = {"baseline": "#3b6ea5", "paper": "#a33a32", "kinran": "#b5872b", "default": "#2b2723"}
LINES = (
    "#2b2723", "#e69f00", "#0072b2", "#009e73", "#cc3311", "#56b4e9", "#aa3377", "#8c6d1f", "#44aa99", "#7a5195",
    "#ee7733", "#3b6ea5", "#b2df8a", "#a33a32", "#f0a0c0", "#117733", "#999933", "#6b6b6b", "#c4a000", "#332288",
)  # fmt: skip
CAP, LEAST_SHARE = 3.0, 1e-4
"""Errors over `CAP` are drawn at the edge: such a fit has exploded. Shares under 1 in 10,000 are drawn at that."""
SPREAD = 0.7
"""Part of the distance of two names over which the methods of each stand."""


def against_cost(rows: list[Row], cost: str, measure: str, size: tuple[int, int] = SIZE) -> Canvas | None:
    """Draw methods as dots on logarithmic axes (PSNR and SSIM on a linear one); None where nothing was measured.

    Methods on the front of the panel, to which no fit is both cheaper and better, are filled and joined by a line.
    """
    likeness = measure.startswith(("psnr", "ssim"))
    known = [row for row in rows if row.experiment == "all" and row[cost] >= 0 and row[measure] > 0]
    if not known:
        return None
    sign = -1 if likeness else 1
    best = front.line([(max(row[cost], LEAST[cost]), sign * row[measure]) for row in known if counts(row, cost)])
    dots = []
    for row in known:
        x, y = max(row[cost], LEAST[cost]), row[measure]
        on_front = counts(row, cost) and (x, sign * y) in best
        says = _values(row) + ("; on the front of this plot" if on_front else "")
        dots.append(plots.Dot(x, y, row.method, FAMILIES[row.family], says, on_front, row.family == "default"))
    floor = next((row for row in rows if row.experiment == "floor"), None) if cost == "microseconds" else None
    limit = (max(floor["microseconds"], LEAST[cost]), _floor(floor)) if floor else None
    x_axis = axes.logarithmic(COSTS[cost], [dot.x for dot in dots] + ([limit[0]] if limit else []))
    y_axis = (axes.linear if likeness else axes.logarithmic)(MEASURES[measure], [dot.y for dot in dots])
    canvas = plots.scatter(dots, x_axis, y_axis, size, [(x, sign * y) for x, y in best], limit)
    _legend(canvas)
    return canvas


def counts(row: Row, cost: str) -> bool:
    """Whether a method can be on the front of a cost: one that keeps all samples has no fit whose cost could count."""
    return cost == "bytes" or row["bytes"] < 6 * row.lights


def _values(row: Row) -> str:
    def value(name: str) -> str:
        return "not known" if math.isnan(row[name]) else f"{row[name]:.3g}"

    return (
        f"{row.method}: relative error {value('relative_error')}, log error {value('log_error')},"
        f" PSNR {value('psnr_display')} dB (linear {value('psnr_linear')}),"
        f" SSIM {value('ssim_display')} (linear {value('ssim_linear')});"
        f" {value('microseconds')} µs, {value('bytes')} bytes, {value('memory_mb')} MB"
    )


def _floor(floor: Row) -> str:
    """The floor of memory bandwidth, in words; a texel's sample under a light is three numbers of four bytes."""
    rate = 12e-3 * floor.lights / floor["microseconds"]
    return f"floor {floor['microseconds']:.2g} µs: the samples read once, at {rate:.2g} GB/s"


def _legend(canvas: Canvas) -> None:
    for k, (family, colour) in enumerate(FAMILIES.items()):
        canvas.dot((LEFT + 8 + 88 * k, 40), colour, 5, family, family == "default")
        canvas.text((LEFT + 18 + 88 * k, 44), family, colour=FAINT, size=11)
    x = LEFT + 8 + 88 * len(FAMILIES)
    canvas.line([(x, 40), (x + 26, 40)], plots.BEST, 4)
    canvas.text((x + 32, 44), "front: no fit is both cheaper and better", colour=FAINT, size=11)


def over_settings(rows: list[Row], measure: str, heading: str, across: str, kind: str, names: Sequence[str]) -> Canvas:
    """Draw a measure of each method over settings, which stand at even distances.

    Parameters
    ----------
    across
        Label of the axis of settings.
    kind
        Kind of the settings: ``number`` (from the least on), ``band`` (in their order), ``name`` (no order: no lines).
    names
        Methods in the order of their colours; the first is drawn boldly.
    """
    settings = list(dict.fromkeys(row.setting for row in rows))
    if kind == "number":
        settings.sort(key=float)
    last = {row.method: row[measure] for row in rows if row.setting == settings[-1]}
    present = sorted({row.method for row in rows}, key=lambda name: (-last.get(name, math.inf), name))
    cap, least = (CAP, axes.LEAST) if measure == "relative_error" else (1.0, LEAST_SHARE)

    def series(k: int, name: str) -> plots.Series:
        own = {row.setting: row[measure] for row in rows if row.method == name}
        beside = SPREAD * ((k + 0.5) / len(present) - 0.5) if kind == "name" else 0.0
        points = [
            (place + beside, cap if math.isnan(own[s]) else min(max(own[s], least), cap), f"{name}, {s}: {own[s]:.3g}")
            for place, s in enumerate(settings)
            if s in own
        ]
        line = LINES[names.index(name) % len(LINES)]
        return plots.Series(name, line, points, bold=name == names[0], joined=kind != "name")

    found = [series(k, name) for k, name in enumerate(present)]
    y = axes.logarithmic(f"{heading}: {MEASURES[measure]}", [value for one in found for _, value, _ in one.points])
    note = f"at {LEAST_SHARE:g}: none" if measure == "texels_above_1" else ""
    if measure == "relative_error" and any(row[measure] > CAP for row in rows):
        note = f"at {CAP:g}: {CAP:g} and more, exploded"
    return plots.lines(found, axes.places(across, settings), y, SIZE, note)


def wrong_labels(rows: Sequence[Row]) -> Canvas:
    """Draw the share of texels with the wrong label, by method, as bars."""
    settings = dict.fromkeys(row.setting for row in rows)
    groups = [(setting, [_bar(row) for row in rows if row.setting == setting]) for setting in settings]
    return plots.bars(groups, SIZE[0], "texels with the wrong label, % (truth from the geometry)")


def _bar(row: Row) -> plots.Bar:
    wrong = 1 - row["accuracy"]
    colour = FAMILIES["kinran" if row.family == "kinran" else "baseline"]
    return plots.Bar(row.method, wrong, f"{100 * wrong:.2f} %", colour)
