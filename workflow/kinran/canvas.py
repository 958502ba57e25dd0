"""A drawing that is written as SVG and as PNG from the same marks."""

from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from kinran.files import atomic

INK, FAINT, GRID, PAPER = "#2b2723", "#8a8178", "#e4ddd3", "#fffdf9"
PLAIN = str.maketrans({"θ": "theta", "µ": "u", "–": "-", "×": "x", "≤": "<=", "≥": ">=", "…": "...", "·": "."})
"""What Pillow's own font cannot write."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Mark:
    """One thing on a canvas.

    Attributes
    ----------
    kind
        ``line`` (of any number of points), ``dot``, ``ring``, ``box`` (two corners) or ``text``.
    points
        Where, in pixels from the top left.
    colour
        As ``#rrggbb``.
    size
        Width of a line, radius of a dot, height of text.
    text
        What a text says; of other marks what a pointer over them shows.
    anchor
        Of a text: ``start``, ``middle`` or ``end``.
    dashed
        Whether a line is.
    series
        Name of what it belongs to, by which a page can pick it out; empty for axes.
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
        """Draw a dot, or a ring, that says `title` under a pointer."""
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
        for mark in other.marks:
            points = tuple((px + x, py + y) for px, py in mark.points)
            self.marks.append(Mark(**{**mark.__dict__, "points": points}))

    def svg(self) -> str:
        """The drawing as an SVG element."""
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width} {self.height}" '
            f'width="{self.width}" height="{self.height}" style="max-width:100%;height:auto" '
            'font-family="system-ui, sans-serif" role="img">'
        )
        paper = f'<rect width="{self.width}" height="{self.height}" fill="{PAPER}"/>'
        return head + paper + "".join(_svg(mark) for mark in self.marks) + "</svg>"

    def png(self, scale: int = 2) -> "np.ndarray[tuple[int, ...], np.dtype[np.uint8]]":
        """The drawing as a picture, `scale` pixels to each of its own."""
        image = Image.new("RGB", (self.width * scale, self.height * scale), PAPER)
        draw = ImageDraw.Draw(image)
        for mark in self.marks:
            _paint(draw, mark, scale)
        return np.asarray(image)


def write(path: Path, canvas: Canvas) -> None:
    """Write a canvas as SVG or PNG, by the suffix, atomically."""
    with atomic(path) as temporary:
        if path.suffix == ".svg":
            temporary.write_text(canvas.svg(), encoding="utf-8")
        else:
            Image.fromarray(canvas.png()).save(temporary, "PNG", optimize=True)


def _svg(mark: Mark) -> str:
    series = f' data-series="{escape(mark.series)}"' if mark.series else ""
    title = f"<title>{escape(mark.text)}</title>" if mark.text and mark.kind != "text" else ""
    (x, y), *rest = mark.points
    if mark.kind == "line":
        points = " ".join(f"{px:.1f},{py:.1f}" for px, py in mark.points)
        dash = ' stroke-dasharray="5 4"' if mark.dashed else ""
        return (
            f'<polyline points="{points}" fill="none" stroke="{mark.colour}" stroke-width="{mark.size:g}"'
            f"{dash}{series}/>"
        )
    if mark.kind == "text":
        return (
            f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{mark.anchor}" fill="{mark.colour}"'
            f' font-size="{mark.size:g}"{series}>{escape(mark.text)}</text>'
        )
    if mark.kind == "box":
        (u, v) = rest[0]
        return (
            f'<rect x="{min(x, u):.1f}" y="{min(y, v):.1f}" width="{abs(u - x):.1f}" height="{abs(v - y):.1f}"'
            f' fill="{mark.colour}"{series}>{title}</rect>'
        )
    style = f'fill="none" stroke="{mark.colour}" stroke-width="2"' if mark.kind == "ring" else f'fill="{mark.colour}"'
    return f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{mark.size:g}" {style}{series}>{title}</circle>'


def _paint(draw: ImageDraw.ImageDraw, mark: Mark, scale: int) -> None:
    points = [(x * scale, y * scale) for x, y in mark.points]
    x, y = points[0]
    width = max(1, round(mark.size * scale))
    if mark.kind == "line":
        for a, b in pairwise(points):
            for start, stop in _dashes(a, b, scale) if mark.dashed else [(a, b)]:
                draw.line([start, stop], fill=mark.colour, width=width)
    elif mark.kind == "text":
        font = ImageFont.load_default(size=mark.size * scale)
        anchor = {"start": "ls", "middle": "ms", "end": "rs"}[mark.anchor]
        draw.text((x, y), mark.text.translate(PLAIN), fill=mark.colour, font=font, anchor=anchor)
    elif mark.kind == "box":
        u, v = points[1]
        draw.rectangle([min(x, u), min(y, v), max(x, u), max(y, v)], fill=mark.colour)
    else:
        r = mark.size * scale
        fill, outline = (None, mark.colour) if mark.kind == "ring" else (mark.colour, None)
        draw.ellipse([x - r, y - r, x + r, y + r], fill=fill, outline=outline, width=2 * scale)


def _dashes(a: Point, b: Point, scale: int) -> list[tuple[Point, Point]]:
    length = max(float(np.hypot(b[0] - a[0], b[1] - a[1])), 1e-9)
    step, on = 9 * scale / length, 5 * scale / length

    def at(t: float) -> Point:
        return a[0] + (b[0] - a[0]) * min(t, 1.0), a[1] + (b[1] - a[1]) * min(t, 1.0)

    return [(at(k * step), at(k * step + on)) for k in range(int(1 / step) + 1) if k * step < 1]
