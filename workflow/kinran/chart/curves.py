"""Methods as lines over what they were given, and bars of wrong labels."""

import math
from collections.abc import Sequence

from kinran.canvas import FAINT, INK, Canvas
from kinran.chart.panel import BOTTOM, HEIGHT, LEFT, MEASURES, TOP, WIDTH, axes, titles
from kinran.chart.rows import Row

LINES = (
    "#2b2723", "#e69f00", "#0072b2", "#009e73", "#cc3311", "#56b4e9", "#aa3377", "#8c6d1f", "#44aa99", "#7a5195",
    "#ee7733", "#3b6ea5", "#b2df8a", "#a33a32", "#f0a0c0", "#117733", "#999933", "#6b6b6b", "#c4a000", "#332288",
)  # fmt: skip
LEGEND = 176
CAP, LEAST_SHARE = 3.0, 1e-4
"""Errors over `CAP` are drawn at the edge: such a fit has exploded. Shares under 1 in 10,000 are drawn at that."""


def curves(rows: list[Row], y: str, words: tuple[str, str], kind: str, names: Sequence[str]) -> Canvas:
    """A measure of each method over settings, which stand at even distances.

    Parameters
    ----------
    words
        Heading, and what lies across.
    kind
        Of the settings: ``number`` (from the least on), ``band`` (in their order), ``name`` (no order: no lines).
    names
        Of the methods, in the order of their colours; the first is drawn boldly.
    """
    canvas = Canvas(WIDTH, HEIGHT)
    settings = list(dict.fromkeys(row.setting for row in rows))
    if kind == "number":
        settings.sort(key=float)
    cap, least = (CAP, 1e-12) if y == "relative_error" else (1.0, LEAST_SHARE)

    def height(row: Row) -> float:
        return min(max(row[y], least), cap) if row[y] == row[y] else cap

    to = axes(canvas, [], [height(row) for row in rows], True, right=LEGEND)
    across = _places(settings)
    for setting in settings:
        canvas.text((across[setting], HEIGHT - BOTTOM + 16), setting, "middle", FAINT, 11)
    titles(canvas, words[1], f"{words[0]}: {MEASURES[y]}", right=LEGEND)
    if y == "relative_error" and any(row[y] > CAP for row in rows):
        canvas.text((LEFT, TOP - 8), f"at {CAP:g}: {CAP:g} and more, exploded", colour=FAINT, size=11)
    if y == "texels_above_1":
        canvas.text((LEFT, TOP - 8), f"at {LEAST_SHARE:g}: none", colour=FAINT, size=11)
    colours = {name: LINES[k % len(LINES)] for k, name in enumerate(names)}
    last = {row.method: row[y] for row in rows if row.setting == settings[-1]}
    present = sorted({row.method for row in rows}, key=lambda name: (-last.get(name, math.inf), name))
    for k, name in enumerate(present):
        own = {row.setting: row for row in rows if row.method == name}
        beside = 5.0 * (k - len(present) / 2) if kind == "name" else 0.0
        order = [s for s in settings if s in own]
        points = [(across[s] + beside, to(1, height(own[s]))[1]) for s in order]
        bold = name == names[0]
        if len(points) > 1 and kind != "name":
            canvas.line(points, colours[name], 3.5 if bold else 1.7, series=name)
        for setting, point in zip(order, points, strict=True):
            says = f"{name}, {setting}: {own[setting][y]:.3g}"
            canvas.dot(point, colours[name], 4.5 if bold else 3.5, says, series=name)
        _entry(canvas, k, name, colours[name])
    return canvas


def _entry(canvas: Canvas, k: int, name: str, colour: str) -> None:
    """A line of the legend."""
    x, y = WIDTH - LEGEND + 12, TOP + 12 + 17 * k
    canvas.line([(x, y - 4), (x + 18, y - 4)], colour, 4, series=name)
    canvas.text((x + 24, y), name, colour=INK, size=11, series=name)


def _places(settings: list[str]) -> dict[str, float]:
    """Where on the x axis each setting stands."""
    step = (WIDTH - LEFT - LEGEND) / len(settings)
    return {setting: LEFT + step * (k + 0.5) for k, setting in enumerate(settings)}


def bars(rows: Sequence[Row]) -> Canvas:
    """Share of texels with the wrong label, by method, as bars on one linear axis."""
    canvas = Canvas(WIDTH, HEIGHT)
    canvas.text((LEFT - 40, 18), "texels with the wrong label, % (truth from the geometry)", "start", INK, 13)
    settings = list(dict.fromkeys(row.setting for row in rows))
    high = max(max(1 - row["accuracy"] for row in rows), 1e-4)
    y = TOP
    for setting in settings:
        canvas.text((LEFT - 40, y + 12), setting, "start", FAINT, 12)
        y += 22
        for row in (row for row in rows if row.setting == setting):
            wrong = 1 - row["accuracy"]
            length = max((WIDTH - 3 * LEFT - 120) * wrong / high, 1.0)
            start = LEFT + 60
            canvas.text((start - 8, y + 14), row.method, "end", INK, 12, series=row.method)
            colour = "#b5872b" if row.family == "kinran" else "#3b6ea5"
            says = f"{row.method}, {setting}: {100 * wrong:.2f} % wrong"
            canvas.box((start, y), (start + length, y + 18), colour, says, row.method)
            canvas.text((start + length + 6, y + 14), f"{100 * wrong:.2f} %", "start", FAINT, 12)
            y += 26
        y += 18
    return canvas
