"""Axes of a plot: their range, their ticks, and the pixel at which a value is drawn."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from kinran.base.drawing.canvas import FAINT, GRID, Canvas, Point

LEFT, RIGHT, TOP, BOTTOM = 64, 18, 56, 48
"""Pixels around the field of a plot: numbers, room, title with legend, numbers with title."""
MOST_TICKS = 8
"""Most ticks of a linear axis."""
DECADES = 2.2
"""A logarithmic axis of fewer decades has ticks at 2 and 5 times the powers of ten, too."""
SHORTEST = 0.5
"""Fewest decades of a logarithmic axis, so that it has a tick: 2 and 5 are 0.4 decades apart."""
LEAST = 1e-6
"""Smallest value of a logarithmic axis; values below are drawn at it."""


@dataclass(frozen=True)
class Axis:
    """One axis of a plot.

    Attributes
    ----------
    title
        Name and unit of the values.
    low, high
        Ends, in the values' unit; decimal logarithms of it where `log` is set.
    ticks
        Value and text of each tick.
    log
        Whether the axis is logarithmic.
    """

    title: str
    low: float
    high: float
    ticks: tuple[tuple[float, str], ...]
    log: bool = False

    def part(self, value: float) -> float:
        """Return the place of a value on the axis, from 0 at the low end to 1 at the high end, where it is clipped."""
        at = math.log10(max(value, LEAST)) if self.log else value
        return (min(max(at, self.low), self.high) - self.low) / (self.high - self.low)


def logarithmic(title: str, values: Sequence[float]) -> Axis:
    """Return a logarithmic axis over positive values and a margin."""
    low, high = _around([math.log10(max(v, LEAST)) for v in values], SHORTEST)
    steps = (1, 2, 5) if high - low < DECADES else (1,)
    ticks = [step * 10.0**k for k in range(math.floor(low), math.ceil(high) + 1) for step in steps]
    return Axis(title, low, high, tuple((v, f"{v:g}") for v in ticks if low <= math.log10(v) <= high), True)


def linear(title: str, values: Sequence[float]) -> Axis:
    """Return a linear axis over values and a margin."""
    low, high = _around(values, 0.01)
    steps = [m * 10.0**k for k in range(-3, 3) for m in (1, 2, 5)]
    step = next((s for s in steps if (high - low) / s <= MOST_TICKS), steps[-1])
    ticks = [round(k * step, 6) for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    return Axis(title, low, high, tuple((v, f"{v:g}") for v in ticks))


def places(title: str, names: Sequence[str]) -> Axis:
    """Return an axis of names, of which name k is at the value k."""
    return Axis(title, -0.5, len(names) - 0.5, tuple((float(k), name) for k, name in enumerate(names)))


def _around(values: Sequence[float], least: float) -> tuple[float, float]:
    """Return the ends of an axis over values and a margin, at least `least` apart."""
    low, high = min(values), max(values)
    margin = max(0.08 * (high - low), (least - high + low) / 2)
    return low - margin, high + margin


@dataclass(frozen=True)
class Field:
    """The field of a plot between its axes on a canvas; `right` is the margin at its right in pixels."""

    canvas: Canvas
    x: Axis
    y: Axis
    right: int = RIGHT

    def at(self, x: float, y: float) -> Point:
        """Return the pixel (x, y) of two values."""
        left, top, right, bottom = self.box
        return left + (right - left) * self.x.part(x), bottom - (bottom - top) * self.y.part(y)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom edge, in pixels."""
        return LEFT, TOP, self.canvas.width - self.right, self.canvas.height - BOTTOM

    def draw(self) -> None:
        """Draw the grid, the numbers, the title of x below and the title of y above."""
        left, top, right, bottom = self.box
        for value, text in self.y.ticks:
            y = bottom - (bottom - top) * self.y.part(value)
            self.canvas.line([(left, y), (right, y)], GRID)
            self.canvas.text((left - 6, y + 4), text, "end", FAINT, 11)
        for value, text in self.x.ticks:
            x = left + (right - left) * self.x.part(value)
            self.canvas.line([(x, top), (x, bottom)], GRID)
            self.canvas.text((x, bottom + 16), text, "middle", FAINT, 11)
        self.canvas.text(((left + right) / 2, bottom + 36), self.x.title, "middle", FAINT)
        self.canvas.text((left - 40, 18), self.y.title, size=13)
