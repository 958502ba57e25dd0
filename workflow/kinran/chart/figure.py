"""The chart as a drawing: error against what it costs, then against what was captured."""

import math
from collections.abc import Callable, Sequence

from kinran.canvas import FAINT, GRID, INK, Canvas, Point
from kinran.chart import front
from kinran.chart.rows import Row

FAMILIES = {"baseline": "#3b6ea5", "paper": "#a33a32", "kinran": "#b5872b", "default": "#2b2723"}
LINES = ("#3b6ea5", "#5b9bd5", "#4d7c4a", "#7d8a2e", "#7a5195", "#a33a32", "#e0a82e", "#9a5b12", "#c46f8f", "#2a9d8f")
WIDTH, HEIGHT = 600, 380
LEFT, RIGHT, TOP, BOTTOM = 62, 18, 46, 46
LEGEND = 128
CAP = 3.0
"""Errors over this are drawn at the edge: such a fit has exploded."""

COSTS = (
    ("microseconds", "processor time, µs a texel"),
    ("bytes", "bytes a texel"),
    ("memory_mb", "memory above the samples, MB"),
)
OTHER = {"relative_error": "psnr_display", "psnr_display": "relative_error"}

To = Callable[[float, float], Point]


def draw(rows: list[Row], heading: bool = True) -> Canvas:
    """All panels of a fabric and, as a heading, what they say about the default."""
    whole = [row for row in rows if row.experiment == "all"]
    floor = next((row["microseconds"] for row in rows if row.experiment == "floor"), math.nan)
    measure = front.judged(rows)
    panels = [
        scatter(known, x, y, title, floor if x == "microseconds" else math.nan)
        for x, title, y in [*((x, title, measure) for x, title in COSTS), (*COSTS[0], OTHER[measure])]
        if (known := [row for row in whole if row[x] >= 0 and row[y] > 0])
    ]
    swept = list(dict.fromkeys(row.method for row in rows if row.experiment == "directions"))
    defaults = [row.method for row in whole if row.family == "default"]
    shown = {*defaults, *swept}
    colours = {name: LINES[k % len(LINES)] for k, name in enumerate(swept)} | dict.fromkeys(defaults, INK)
    for experiment, title, kind in (
        ("directions", "directions", "number"),
        ("exposures", "exposures kept, longest first", "number"),
        ("theta", "θ of the light; dashed: fitted to θ ≤ 50° alone", "band"),
        ("region", "region", "name"),
    ):
        some = [row for row in rows if row.experiment == experiment and row.method in shown]
        beyond = [row for row in rows if row.experiment == "extrapolation"] if experiment == "theta" else []
        if some:
            panels.append(lines(some, title, kind, colours, beyond))
    words = [part for sentence in front.verdict(rows) for part in _wrap(sentence, 150)] if heading else []
    head = 58 + 18 * len(words) if heading else 0
    canvas = Canvas(2 * WIDTH + 20, head + HEIGHT * math.ceil(len(panels) / 2) + 10)
    if heading:
        canvas.text((20, 32), f"{rows[0].fabric}: accuracy against speed, on held-out lights", size=20)
    for k, part in enumerate(words):
        canvas.text((20, 56 + 18 * k), part, colour=FAINT, size=13)
    for k, panel in enumerate(panels):
        canvas.paste(panel, 10 + WIDTH * (k % 2), head + HEIGHT * (k // 2))
    return canvas


def scatter(rows: list[Row], x: str, y: str, title: str, floor: float = math.nan) -> Canvas:
    """Methods as dots on logarithmic axes (PSNR on a linear one), with the front of the two."""
    canvas = Canvas(WIDTH, HEIGHT)
    lowest = 0.02 if x == "microseconds" else 1.0
    points = [(max(row[x], lowest), row[y]) for row in rows]
    decibels = y.startswith("psnr")
    to = _axes(
        canvas, [p[0] for p in points] + ([floor] if floor == floor else []), [p[1] for p in points], not decibels
    )
    _titles(canvas, title, "PSNR, display values, dB" if decibels else "relative error")
    if floor == floor:
        a, b = to(floor, 1)[0], HEIGHT - BOTTOM
        canvas.line([(a, TOP), (a, b)], INK, 1, dashed=True)
        canvas.text((a + 4, b - 6), "reading the samples once", colour=FAINT, size=10)
    best = front.line([(c, -e if decibels else e) for c, e in points])
    canvas.line([to(c, -e if decibels else e) for c, e in best], GRID, 3)
    _dots(canvas, rows, [to(*point) for point in points], x, y)
    for k, family in enumerate(FAMILIES):
        canvas.dot((LEFT + 8 + 92 * k, 34), FAMILIES[family], 4, family, family == "default")
        canvas.text((LEFT + 16 + 92 * k, 38), family, colour=FAINT, size=11)
    return canvas


def _dots(canvas: Canvas, rows: list[Row], at: list[Point], x: str, y: str) -> None:
    taken = [(px - 6, py - 6, px + 6, py + 6) for px, py in at]
    for row, (px, py) in zip(rows, at, strict=True):
        default = row.family == "default"
        title = f"{row.method}: {row[x]:.3g}, {row[y]:.3g}"
        canvas.dot((px, py), FAMILIES[row.family], 8 if default else 5, title, default, row.method)
    for row, (px, py) in zip(rows, at, strict=True):
        width = 5.6 * len(row.method)
        places = [(a, b) for b in (4, -10, 18, -24, 32, -38, 46, -52) for a in (9, -9 - width, -width / 2)]
        boxes = [(px + a, py + b - 10, px + a + width, py + b + 3) for a, b in places]
        # the first free place, which is the nearest
        best = min(boxes, key=lambda box: round(sum(_overlap(box, other) for other in taken) + _outside(box)))
        taken.append(best)
        canvas.text((best[0], best[3] - 3), row.method, colour=INK, size=11, series=row.method)


def _overlap(a: Sequence[float], b: Sequence[float]) -> float:
    return max(0, min(a[2], b[2]) - max(a[0], b[0])) * max(0, min(a[3], b[3]) - max(a[1], b[1]))


def _outside(box: Sequence[float]) -> float:
    return 1e4 * (box[0] < LEFT + 2 or box[2] > WIDTH - 4 or box[1] < TOP - 6 or box[3] > HEIGHT - BOTTOM)


def lines(rows: list[Row], title: str, kind: str, colours: dict[str, str], dashed: Sequence[Row] = ()) -> Canvas:
    """Relative error of each method over settings.

    Parameters
    ----------
    kind
        Of the settings: ``number`` (a logarithmic axis), ``band`` (in their order), ``name`` (no order: no lines).
    colours
        Of the methods by name, in the order of the legend.
    dashed
        Rows to draw dashed in the same colours.
    """
    canvas = Canvas(WIDTH, HEIGHT)
    settings = list(dict.fromkeys(row.setting for row in rows))
    if kind == "number":
        settings.sort(key=float)
    values = [min(row["relative_error"], CAP) for row in [*rows, *dashed]]
    to = _axes(canvas, [], values, True, right=LEGEND)
    across = _places(settings, kind == "number")
    written = -math.inf
    for setting in settings:
        if across[setting] - written > 24:
            written = across[setting]
            canvas.text((written, HEIGHT - BOTTOM + 16), setting, "middle", FAINT, 11)
    _titles(canvas, title, "relative error", right=LEGEND)
    present = {row.method for row in rows}
    for k, name in enumerate(name for name in colours if name in present):
        for source, broken in ((rows, False), (dashed, True)):
            own = {row.setting: min(row["relative_error"], CAP) for row in source if row.method == name}
            beside = 4.0 * (k - len(present) / 2) if kind == "name" else 0.0
            points = [(across[s] + beside, to(1, own[s])[1]) for s in settings if s in own]
            if len(points) > 1 and kind != "name":
                canvas.line(points, colours[name], 2, broken, name)
            for setting, point in zip([s for s in settings if s in own], points, strict=True):
                canvas.dot(point, colours[name], 4, f"{name}, {setting}: {own[setting]:.3g}", broken, name)
        y = TOP + 12 + 17 * k
        canvas.line([(WIDTH - 120, y - 4), (WIDTH - 102, y - 4)], colours[name], 3, series=name)
        canvas.text((WIDTH - 97, y), name, colour=INK, size=11, series=name)
    return canvas


def _places(settings: list[str], by_number: bool) -> dict[str, float]:
    """Where on the x axis each setting stands."""
    place = [math.log(float(s)) if by_number else float(k) for k, s in enumerate(settings)]
    low, span = min(place), max(max(place) - min(place), 1e-9)
    return {
        s: LEFT + 22 + (WIDTH - LEFT - LEGEND - 44) * (p - low) / span for s, p in zip(settings, place, strict=True)
    }


def _axes(canvas: Canvas, xs: list[float], ys: list[float], log_y: bool, right: int = RIGHT) -> To:
    """Grid and numbers; returns what takes values to the canvas. Without xs there is no x axis."""
    x0, x1 = _range(xs, True) if xs else (0.0, 1.0)
    y0, y1 = _range(ys, log_y)

    def to(x: float, y: float) -> Point:
        v = math.log10(max(y, 1e-12)) if log_y else y
        return (
            LEFT + (WIDTH - LEFT - right) * ((math.log10(x) if xs else 0.0) - x0) / (x1 - x0),
            HEIGHT - BOTTOM - (HEIGHT - TOP - BOTTOM) * (min(max(v, y0), y1) - y0) / (y1 - y0),
        )

    for value in _ticks(y0, y1, log_y):
        y = to(1, value)[1]
        canvas.line([(LEFT, y), (WIDTH - right, y)], GRID)
        canvas.text((LEFT - 6, y + 4), f"{value:g}", "end", FAINT, 11)
    for value in _ticks(x0, x1, True) if xs else []:
        x = to(value, 1)[0]
        canvas.line([(x, TOP), (x, HEIGHT - BOTTOM)], GRID)
        canvas.text((x, HEIGHT - BOTTOM + 16), f"{value:g}", "middle", FAINT, 11)
    return to


def _titles(canvas: Canvas, x: str, y: str, right: int = RIGHT) -> None:
    canvas.text(((LEFT + WIDTH - right) / 2, HEIGHT - 12), x, "middle", FAINT, 12)
    canvas.text((LEFT, 16), y, "start", INK, 12)


def _range(values: list[float], log: bool) -> tuple[float, float]:
    logs = [math.log10(max(v, 1e-6)) for v in values] if log else list(values)
    low, high = (min(logs), max(logs)) if logs else (0.0, 1.0)
    margin = 0.1 * max(high - low, 0.3 if log else 1.0)
    return low - margin, high + margin


def _ticks(low: float, high: float, log: bool) -> list[float]:
    if not log:
        step = next(s for s in (0.5, 1, 2, 5, 10, 20, 50, 100) if (high - low) / s <= 8 or s == 100)
        return [k * step for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    steps = (1, 2, 5) if high - low < 2.2 else (1,)
    found = [s * 10.0**k for k in range(math.floor(low), math.ceil(high) + 1) for s in steps]
    return [v for v in found if low <= math.log10(v) <= high]


def _wrap(text: str, width: int) -> list[str]:
    lines, line = [], ""
    for word in text.split():
        if len(line) + len(word) + 1 > width:
            lines.append(line)
            line = word
        else:
            line = f"{line} {word}".strip()
    return [*lines, line]
