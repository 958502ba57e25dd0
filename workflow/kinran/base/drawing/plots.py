"""Plots of named things: dots at two values with their best line, lines over settings, bars."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinran.base.drawing import names
from kinran.base.drawing.axes import LEFT, TOP, Axis, Field
from kinran.base.drawing.canvas import FAINT, INK, PAPER, Canvas, Point

COLOURS = ("#b5872b", "#a33a32", "#3b6ea5", "#4d7c4a", "#7a5195", "#6b6b6b")
"""Colours of series that have none of their own."""
BEST = "#d9c69a"
"""Colour of the line through the best dots."""
LEGEND = 176
"""Width of the legend of a plot of lines, in pixels."""
CHARACTER = 7.0
"""Width of a character at a bar, in pixels."""
APART = 14
"""Distance in pixels beyond which a thin line joins a name to its dot."""


@dataclass(frozen=True)
class Dot:
    """A named thing at two values.

    Attributes
    ----------
    x, y
        Values on the axes.
    says
        Tooltip.
    best
        Whether it is drawn at full strength.
    ring
        Whether a ring marks it as the one that the plot is about.
    """

    x: float
    y: float
    name: str
    colour: str
    says: str
    best: bool = True
    ring: bool = False


@dataclass(frozen=True)
class Series:
    """A named line.

    Attributes
    ----------
    points
        x, y and tooltip of each point.
    bold
        Whether it is the one that the plot is about.
    joined
        Whether a line goes through the points.
    """

    name: str
    colour: str
    points: Sequence[tuple[float, float, str]]
    bold: bool = False
    joined: bool = True


@dataclass(frozen=True)
class Bar:
    """A named bar of length `value`, with `text` at its end."""

    name: str
    value: float
    text: str
    colour: str = COLOURS[0]


def colour(index: int) -> str:
    """Return the colour of the series `index`."""
    return COLOURS[index % len(COLOURS)]


def scatter(
    dots: Sequence[Dot],
    x: Axis,
    y: Axis,
    size: tuple[int, int],
    line: Sequence[Point] = (),
    limit: tuple[float, str] | None = None,
) -> Canvas:
    """Return a scatter plot, with a name beside each dot.

    Parameters
    ----------
    size
        Width and height in pixels.
    line
        Values that the line through the best dots passes through.
    limit
        Lower bound on x, and its label.
    """
    canvas = Canvas(*size)
    field = Field(canvas, x, y)
    field.draw()
    at = [field.at(dot.x, dot.y) for dot in dots]
    taken = [(px - 6, py - 6, px + 6, py + 6) for px, py in at]
    if limit:
        taken.append(_limit(field, *limit, taken))
    if line:
        canvas.line([field.at(*point) for point in line], BEST, 4)
    for dot, point in zip(dots, at, strict=True):
        if dot.ring:
            canvas.dot(point, dot.colour, 9, dot.says, True, dot.name)
        if dot.best or not dot.ring:
            canvas.dot(point, dot.colour if dot.best else _pale(dot.colour), 5, dot.says, series=dot.name)
    for dot, point in sorted(zip(dots, at, strict=True), key=lambda pair: (not pair[0].ring, not pair[0].best)):
        taken.append(_name(field, dot, point, taken))
    return canvas


def _limit(field: Field, value: float, text: str, taken: Sequence[names.Box]) -> names.Box:
    """Draw a vertical line, with its text where the fewest dots are; return the box of the text."""
    _, top, _, bottom = field.box
    x, _ = field.at(value, 0)
    field.canvas.line([(x, top), (x, bottom)], INK, dashed=True)
    width, tops = names.CHARACTER * len(text), np.arange(top + 2, bottom - 16, 16.0)
    boxes = np.stack([np.full_like(tops, x + 4), tops, np.full_like(tops, x + 4 + width), tops + 16], 1)
    left, top, right, bottom = boxes[np.argmin(names.covered(boxes, taken))].tolist()
    field.canvas.text((left, bottom - 4), text, colour=FAINT, size=11)
    return left, top, right, bottom


def _name(field: Field, dot: Dot, at: Point, taken: Sequence[names.Box]) -> names.Box:
    """Write a dot's name, with a thin line to the dot where they are apart; return the box of the name."""
    left, top, _, bottom = field.box
    box = names.place(dot.name, at, taken, (left + 2, top - 4, field.canvas.width - 4, bottom))
    nearest = (min(max(at[0], box[0]), box[2]), min(max(at[1], box[1]), box[3]))
    if math.dist(nearest, at) > APART:
        field.canvas.line([at, nearest], FAINT, 0.7, series=dot.name)
    ink = INK if dot.best or dot.ring else FAINT
    field.canvas.text((box[0], box[3] - 3), dot.name, colour=ink, size=11, series=dot.name)
    return box


def lines(series: Sequence[Series], x: Axis, y: Axis, size: tuple[int, int], note: str = "") -> Canvas:
    """Return a plot of lines through points, with a legend in the order of the series and `note` above."""
    canvas = Canvas(*size)
    field = Field(canvas, x, y, LEGEND)
    field.draw()
    if note:
        canvas.text((LEFT, TOP - 8), note, colour=FAINT, size=11)
    for k, one in enumerate(series):
        at = [field.at(px, py) for px, py, _ in one.points]
        if one.joined and len(at) > 1:
            canvas.line(at, one.colour, 3.5 if one.bold else 1.7, series=one.name)
        for point, (_, _, says) in zip(at, one.points, strict=True):
            canvas.dot(point, one.colour, 4.5 if one.bold else 3.5, says, series=one.name)
        left, middle = size[0] - LEGEND + 12, TOP + 8 + 17 * k
        canvas.line([(left, middle), (left + 18, middle)], one.colour, 4, series=one.name)
        canvas.text((left + 24, middle + 4), one.name, size=11, series=one.name)
    return canvas


def bars(groups: Sequence[tuple[str, Sequence[Bar]]], width: int, title: str = "") -> Canvas:
    """Return horizontal bars from 0, in groups with headings."""
    found = [bar for _, group in groups for bar in group]
    left = 24 + CHARACTER * max((len(bar.name) for bar in found), default=0)
    room = width - left - 24 - CHARACTER * max((len(bar.text) for bar in found), default=0)
    high = max((bar.value for bar in found), default=0) or 1
    canvas = Canvas(width, 0)
    y = 8.0
    if title:
        canvas.text((24, 18), title, size=13)
        y = 46.0
    for heading, group in groups:
        if heading:
            canvas.text((24, y + 12), heading, colour=FAINT)
            y += 22
        for bar in group:
            end = left + max(room * bar.value / high, 1.0)
            canvas.text((left - 8, y + 13), bar.name, "end", series=bar.name)
            says = ", ".join(filter(None, (bar.name, heading))) + f": {bar.text}"
            canvas.box((left, y), (end, y + 18), bar.colour, says, bar.name)
            canvas.text((end + 6, y + 13), bar.text, colour=FAINT)
            y += 24
        y += 12 if heading else 0
    canvas.height = round(y) + 4
    return canvas


def _pale(colour: str) -> str:
    """Return the colour half way to the background's."""
    pairs = [(int(colour[k : k + 2], 16) + int(PAPER[k : k + 2], 16)) // 2 for k in (1, 3, 5)]
    return "#" + "".join(f"{value:02x}" for value in pairs)
