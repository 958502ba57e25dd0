"""A drawing that is written as SVG and as PNG from the same marks."""

import math
from dataclasses import dataclass, field, replace
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from kinran.base.files import atomic

INK, FAINT, GRID, PAPER = "#2b2723", "#8a8178", "#e4ddd3", "#fffdf9"
"""Colours of text and lines, of what stands back, of grids, and of the background."""
PLAIN = str.maketrans(
    {"θ": "theta", "φ": "phi", "µ": "u", "–": "-", "×": "x", "≤": "<=", "≥": ">=", "…": "...", "·": "."}
)
"""Replacements of characters that Pillow's own font lacks."""
DASH, STEP = 5, 9
"""Length of a dash, and of a dash with its gap, in pixels."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """One mark on a canvas.

    Attributes
    ----------
    kind
        ``line`` (through any number of points), ``dot``, ``ring``, ``box`` (two corners) or ``text``.
    points
        Points in pixels from the top left.
    colour
        Colour as ``#rrggbb`` or ``rgb(r,g,b)``.
    size
        Width of a line, radius of a dot or height of text, in pixels.
    text
        Content of a text; tooltip of another mark.
    anchor
        Anchor of a text: ``start``, ``middle`` or ``end``.
    dashed
        Whether a line is dashed.
    series
        Name of the series that the mark belongs to, by which a page selects it; empty for axes.
    """

    kind: str
    points: tuple[Point, ...]
    colour: str
    size: float
    text: str = ""
    anchor: str = "start"
    dashed: bool = False
    series: str = ""


@dataclass
class Canvas:
    """Marks in the order in which they are drawn."""

    width: int
    height: int
    marks: list[Mark] = field(default_factory=list)

    def line(self, points: list[Point], colour: str, size: float = 1, dashed: bool = False, series: str = "") -> None:
        """Draw a line through points."""
        self.marks.append(Mark("line", tuple(points), colour, size, dashed=dashed, series=series))

    def dot(self, at: Point, colour: str, size: float, title: str, ring: bool = False, series: str = "") -> None:
        """Draw a dot, or a ring, with the tooltip `title`."""
        self.marks.append(Mark("ring" if ring else "dot", (at,), colour, size, title, series=series))

    def text(
        self, at: Point, text: str, anchor: str = "start", colour: str = INK, size: float = 12, series: str = ""
    ) -> None:
        """Write text with its baseline at `at`."""
        self.marks.append(Mark("text", (at,), colour, size, text, anchor, series=series))

    def box(self, first: Point, second: Point, colour: str, title: str = "", series: str = "") -> None:
        """Fill a box between two corners."""
        self.marks.append(Mark("box", (first, second), colour, 0, title, series=series))

    def paste(self, other: "Canvas", x: float, y: float) -> None:
        """Draw another canvas with its top left corner at (x, y)."""
        self.marks += [replace(m, points=tuple((px + x, py + y) for px, py in m.points)) for m in other.marks]

    def svg(self, title: str) -> Markup:
        """Return the drawing as an SVG element, with `title` for screen readers."""
        paper = _element("rect", "", width=self.width, height=self.height, fill=PAPER)
        return Markup(
            _element(
                "svg",
                paper + "".join(map(_svg, self.marks)),
                xmlns="http://www.w3.org/2000/svg",
                viewBox=f"0 0 {self.width} {self.height}",
                width=self.width,
                height=self.height,
                style="max-width:100%;height:auto",
                font_family="system-ui, sans-serif",
                role="img",
                aria_label=title,
            )
        )

    def png(self, scale: int = 2) -> NDArray[np.uint8]:
        """Return the drawing as an RGB picture, enlarged by `scale`."""
        image = Image.new("RGB", (self.width * scale, self.height * scale), PAPER)
        draw = ImageDraw.Draw(image)
        for mark in self.marks:
            _paint(draw, mark, scale)
        return np.asarray(image)


def write(path: Path, canvas: Canvas) -> None:
    """Write a canvas as SVG or PNG, by the suffix, atomically."""
    with atomic(path) as temporary:
        if path.suffix == ".svg":
            temporary.write_text(canvas.svg(path.stem), encoding="utf-8")
        else:
            Image.fromarray(canvas.png()).save(temporary, "PNG", optimize=True)


def _element(name: str, inside: str, **attributes: object) -> str:
    """Return an SVG element around markup, with numbers to a tenth of a pixel and without empty attributes."""
    words = [name]
    for key, value in attributes.items():
        text = f"{round(value, 1):g}" if isinstance(value, float) else str(value)
        words += [f'{key.replace("_", "-")}="{escape(text)}"'] if text else []
    return f"<{' '.join(words)}>{inside}</{name}>"


def _svg(mark: Mark) -> str:
    drawn: dict[str, object]
    (x, y), *rest = mark.points
    title = _element("title", escape(mark.text)) if mark.text else ""
    if mark.kind == "line":
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in mark.points)
        dash = f"{DASH} {STEP - DASH}" if mark.dashed else ""
        drawn = {"fill": "none", "stroke": mark.colour, "stroke_width": mark.size, "stroke_dasharray": dash}
        return _element("polyline", "", points=points, **drawn, data_series=mark.series)
    drawn = {"fill": mark.colour, "data_series": mark.series}
    if mark.kind == "text":
        drawn |= {"text_anchor": mark.anchor, "font_size": mark.size}
        return _element("text", escape(mark.text), x=x, y=y, **drawn)
    if mark.kind == "box":
        u, v = rest[0]
        return _element("rect", title, x=min(x, u), y=min(y, v), width=abs(u - x), height=abs(v - y), **drawn)
    if mark.kind == "ring":
        drawn |= {"fill": "none", "stroke": mark.colour, "stroke_width": 2}
    return _element("circle", title, cx=x, cy=y, r=mark.size, **drawn)


def _paint(draw: ImageDraw.ImageDraw, mark: Mark, scale: int) -> None:
    points = [(x * scale, y * scale) for x, y in mark.points]
    x, y = points[0]
    if mark.kind == "line":
        for a, b in pairwise(points):
            for start, stop in _dashes(a, b, scale) if mark.dashed else [(a, b)]:
                draw.line([start, stop], fill=mark.colour, width=max(1, round(mark.size * scale)))
    elif mark.kind == "text":
        font = ImageFont.load_default(size=mark.size * scale)
        anchor = {"start": "ls", "middle": "ms", "end": "rs"}[mark.anchor]
        draw.text((x, y), mark.text.translate(PLAIN), fill=mark.colour, font=font, anchor=anchor)
    elif mark.kind == "box":
        u, v = points[1]
        draw.rectangle([min(x, u), min(y, v), max(x, u), max(y, v)], fill=mark.colour)
    else:
        fill, outline = (None, mark.colour) if mark.kind == "ring" else (mark.colour, None)
        draw.circle((x, y), mark.size * scale, fill=fill, outline=outline, width=2 * scale)


def _dashes(a: Point, b: Point, scale: int) -> list[tuple[Point, Point]]:
    """Return the ends of the dashes of a line from a to b."""
    length = max(math.dist(a, b), 1e-9)

    def at(pixels: float) -> Point:
        t = min(pixels * scale / length, 1.0)
        return a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t

    return [(at(k * STEP), at(k * STEP + DASH)) for k in range(math.ceil(length / (STEP * scale)))]
