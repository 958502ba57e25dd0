"""Methods as dots: an error against a cost, with the front of the two."""

import math
from collections.abc import Sequence

from kinran.canvas import FAINT, INK, PAPER, Canvas, Point
from kinran.chart import front
from kinran.chart.panel import (
    BOTTOM,
    COSTS,
    HEIGHT,
    LEAST,
    LEFT,
    MEASURES,
    TOP,
    WIDTH,
    axes,
    higher_is_better,
    titles,
)  # fmt: skip
from kinran.chart.rows import Row

FAMILIES = {"baseline": "#3b6ea5", "paper": "#a33a32", "kinran": "#b5872b", "default": "#2b2723"}
FRONT = "#d9c69a"
RINGS = (11, 16, 22, 30, 40, 52, 66, 82, 100)
"""Distances at which a label's place is looked for."""
TURNS = 16
CHARACTER = 6.2
"""Width of a character of a label."""

Box = tuple[float, float, float, float]


def scatter(rows: list[Row], x: str, y: str, floor: Row | None = None) -> Canvas:
    """Methods as dots on logarithmic axes (of likeness on a linear one).

    Methods on the front of the panel, to which no fit is both cheaper and better, are filled and joined by a line.

    Parameters
    ----------
    x, y
        Cost and measure.
    floor
        What reading the samples once costs.
    """
    canvas = Canvas(WIDTH, HEIGHT)
    points = [(max(row[x], LEAST[x]), row[y]) for row in rows]
    likeness = higher_is_better(y)
    lowest = [max(floor["microseconds"], LEAST[x])] if floor else []
    to = axes(canvas, [p[0] for p in points] + lowest, [p[1] for p in points], not likeness)
    titles(canvas, COSTS[x], MEASURES[y])
    at = [to(*point) for point in points]
    taken: list[Box] = [(px - 6, py - 6, px + 6, py + 6) for px, py in at]
    if floor:
        taken.append(_floor(canvas, floor, to(lowest[0], 1)[0], taken))
    sign = -1 if likeness else 1
    judged = [(cost, sign * value) for (cost, value), row in zip(points, rows, strict=True) if counts(row, x)]
    best = front.line(judged)
    canvas.line([to(cost, sign * value) for cost, value in best], FRONT, 4)
    on_front = [
        counts(row, x) and (cost, sign * value) in best for (cost, value), row in zip(points, rows, strict=True)
    ]
    _dots(canvas, rows, at, on_front, x, y)
    _labels(canvas, rows, at, on_front, taken)
    _legend(canvas)
    return canvas


def counts(row: Row, cost: str) -> bool:
    """Whether a method can be on the front of a cost: what keeps its samples whole has no fit to cost anything."""
    return cost == "bytes" or row["bytes"] < 6 * row.lights


def _floor(canvas: Canvas, floor: Row, x: float, taken: Sequence[Box]) -> Box:
    """The line that memory bandwidth sets, with its number where no dot is; returns where that stands."""
    rate = 12e-3 * floor.lights / floor["microseconds"]
    canvas.line([(x, TOP), (x, HEIGHT - BOTTOM)], INK, 1, dashed=True)
    label = f"floor {floor['microseconds']:.2g} µs: the samples read once, at {rate:.2g} GB/s"
    width = CHARACTER * len(label)
    boxes = [(x + 4, top, x + 4 + width, top + 16) for top in range(TOP + 2, HEIGHT - BOTTOM - 16, 16)]
    box = min(boxes, key=lambda place: sum(_overlap(place, other) for other in taken))
    canvas.text((box[0], box[3] - 4), label, colour=FAINT, size=11)
    return box


def _legend(canvas: Canvas) -> None:
    for k, (family, colour) in enumerate(FAMILIES.items()):
        canvas.dot((LEFT + 8 + 88 * k, 40), colour, 5, family, family == "default")
        canvas.text((LEFT + 18 + 88 * k, 44), family, colour=FAINT, size=11)
    x = LEFT + 8 + 88 * len(FAMILIES)
    canvas.line([(x, 40), (x + 26, 40)], FRONT, 4)
    canvas.text((x + 32, 44), "front: no fit is both cheaper and better", colour=FAINT, size=11)


def _dots(canvas: Canvas, rows: list[Row], at: list[Point], on_front: list[bool], x: str, y: str) -> None:
    for row, (px, py), best in zip(rows, at, on_front, strict=True):
        title = f"{row.method}: {row[x]:.3g} {_unit(x)}, {y.replace('_', ' ')} {row[y]:.4g}"
        if row.family == "default":
            canvas.dot((px, py), FAMILIES[row.family], 9, title, True, row.method)
        if row.family != "default" or best:
            colour = FAMILIES[row.family]
            canvas.dot((px, py), colour if best else _pale(colour), 5, title, False, row.method)


def _labels(canvas: Canvas, rows: list[Row], at: list[Point], on_front: list[bool], taken: list[Box]) -> None:
    """Names where there is room, the default's and the front's first; a thin line leads to those that stand off."""
    order = sorted(range(len(rows)), key=lambda k: (rows[k].family != "default", not on_front[k]))
    for k in order:
        width = CHARACTER * len(rows[k].method)
        box = min(_places(at[k], width), key=lambda place: _badness(place, at[k], taken))
        taken.append(box)
        middle = (min(max(at[k][0], box[0]), box[2]), min(max(at[k][1], box[1]), box[3]))
        if math.dist(middle, at[k]) > 14:
            canvas.line([at[k], middle], FAINT, 0.7, series=rows[k].method)
        colour = INK if on_front[k] or rows[k].family == "default" else FAINT
        canvas.text((box[0], box[3] - 3), rows[k].method, colour=colour, size=11, series=rows[k].method)


def _places(at: Point, width: float) -> list[Box]:
    """Boxes around a dot in which its label may stand, the nearest first."""
    boxes = []
    for radius in RINGS:
        for k in range(TURNS):
            cosine, sine = math.cos(2 * math.pi * k / TURNS), math.sin(2 * math.pi * k / TURNS)
            left = at[0] + radius * cosine - width * (1 - cosine) / 2
            top = at[1] + radius * sine - 7
            boxes.append((left, top, left + width, top + 14))
    return boxes


def _badness(box: Box, at: Point, taken: Sequence[Box]) -> float:
    overlap = sum(
        max(0.0, min(box[2], other[2]) - max(box[0], other[0]))
        * max(0.0, min(box[3], other[3]) - max(box[1], other[1]))
        for other in taken
    )
    outside = box[0] < LEFT + 2 or box[2] > WIDTH - 4 or box[1] < TOP - 4 or box[3] > HEIGHT - BOTTOM
    near = math.dist((min(max(at[0], box[0]), box[2]), min(max(at[1], box[1]), box[3])), at)
    return 20 * overlap + 1e5 * outside + near


def _overlap(a: Box, b: Box) -> float:
    return max(0.0, min(a[2], b[2]) - max(a[0], b[0])) * max(0.0, min(a[3], b[3]) - max(a[1], b[1]))


def _unit(cost: str) -> str:
    return {"microseconds": "µs", "bytes": "bytes", "memory_mb": "MB"}[cost]


def _pale(colour: str) -> str:
    """Half way to the paper."""
    pairs = [(int(colour[k : k + 2], 16) + int(PAPER[k : k + 2], 16)) // 2 for k in (1, 3, 5)]
    return "#" + "".join(f"{value:02x}" for value in pairs)
