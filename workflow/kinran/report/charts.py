"""Charts of the report, as SVG text."""

import math
from collections.abc import Sequence
from html import escape

INK, FAINT, GRID = "#2b2723", "#8a8178", "#e4ddd3"
COLOURS = ("#b5872b", "#a33a32", "#3b6ea5", "#4d7c4a", "#7a5195", "#6b6b6b")


def colour(index: int) -> str:
    """Colour of the series `index`."""
    return COLOURS[index % len(COLOURS)]


def _svg(width: int, height: int, parts: Sequence[str], title: str) -> str:
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img" '
        f'aria-label="{escape(title)}"><title>{escape(title)}</title>{"".join(parts)}</svg>'
    )


def _text(x: float, y: float, text: str, anchor: str = "middle", fill: str = INK, size: int = 12) -> str:
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{fill}" font-size="{size}">{escape(text)}</text>'
    )


def _dot(x: float, y: float, r: float, fill: str, title: str, stroke: str = "none") -> str:
    return (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{r}" fill="{fill}" stroke="{stroke}">'
        f"<title>{escape(title)}</title></circle>"
    )


def lights(points: Sequence[tuple[str, float, float, bool]]) -> str:
    """Light directions (name, θ, φ in radians, held out) seen from the camera; the rim is the horizon."""
    size, radius = 360, 160
    c = size / 2
    parts = [f'<circle cx="{c}" cy="{c}" r="{radius}" fill="#fbf8f2" stroke="{GRID}"/>']
    for degrees in (30, 60):
        parts.append(
            f'<circle cx="{c}" cy="{c}" r="{radius * degrees / 90:.1f}" fill="none" stroke="{GRID}"/>'
            + _text(c + 3, c - radius * degrees / 90 + 12, f"{degrees}°", "start", FAINT, 10)
        )
    for name, theta, phi, held in points:
        r = radius * theta / (math.pi / 2)
        x, y = c + r * math.cos(phi), c - r * math.sin(phi)
        where = f"{name}: θ {math.degrees(theta):.0f}°, φ {math.degrees(phi):.0f}°{', held out' if held else ''}"
        parts.append(
            _dot(x, y, 3.6 if held else 2.6, "#fff" if held else colour(0), where, colour(1) if held else "none")
        )
    parts += [_text(c + radius + 10, c + 4, "X", fill=FAINT), _text(c, c - radius - 6, "Y", fill=FAINT)]
    return _svg(size, size, parts, "Light directions; rings are held out")


def bars(rows: Sequence[tuple[str, float, str]], width: int = 560) -> str:
    """Horizontal bars: (label, value, text at the bar)."""
    left, step = 150, 24
    high = max((value for _, value, _ in rows), default=1) or 1
    parts = []
    for k, (label, value, text) in enumerate(rows):
        y, length = 4 + k * step, (width - left - 110) * value / high
        parts.append(_text(left - 8, y + 14, label, "end"))
        parts.append(f'<rect x="{left}" y="{y}" width="{max(length, 1):.1f}" height="16" rx="2" fill="{colour(0)}"/>')
        parts.append(_text(left + max(length, 1) + 6, y + 13, text, "start", FAINT))
    return _svg(width, 8 + step * len(rows), parts, "Bars")


def grouped(groups: Sequence[str], series: Sequence[tuple[str, Sequence[float]]], unit: str, width: int = 640) -> str:
    """Vertical bars of several series side by side for each group; values from 0 on."""
    left, top, bottom, height = 48, 26, 28, 240
    high = max((value for _, values in series for value in values), default=1) or 1
    span = (width - left - 10) / max(len(groups), 1)
    bar = min(26.0, span * 0.8 / max(len(series), 1))
    parts = [_text(left, 14, unit, "start", FAINT)]
    for part in (0, 0.25, 0.5, 0.75, 1.0):
        y = top + (height - top - bottom) * (1 - part)
        parts.append(f'<line x1="{left}" x2="{width}" y1="{y:.1f}" y2="{y:.1f}" stroke="{GRID}"/>')
        parts.append(_text(left - 6, y + 4, f"{high * part:.2g}", "end", FAINT, 11))
    for g, name in enumerate(groups):
        middle = left + span * (g + 0.5)
        parts.append(_text(middle, height - 8, name))
        for s, (label, values) in enumerate(series):
            length = (height - top - bottom) * values[g] / high
            x = middle + bar * (s - len(series) / 2)
            parts.append(
                f'<rect x="{x:.1f}" y="{height - bottom - length:.1f}" width="{bar - 2:.1f}" height="{length:.1f}"'
                f' fill="{colour(s)}"><title>{escape(f"{label}, {name}: {values[g]:.4g}")}</title></rect>'
            )
    for s, (label, _) in enumerate(series):
        x = left + 130 * (s + 1)
        parts.append(
            f'<rect x="{x}" y="6" width="10" height="10" fill="{colour(s)}"/>' + _text(x + 15, 15, label, "start")
        )
    return _svg(width, height, parts, f"{unit} by region")


def scatter(
    points: Sequence[tuple[str, float, float]],
    x_title: str,
    y_title: str,
    width: int = 480,
    height: int = 300,
) -> str:
    """Named points (name, x > 0, y > 0) on logarithmic axes."""
    left, right, top, bottom = 64, 90, 16, 44
    x0, x1 = _decades([x for _, x, _ in points])
    y0, y1 = _decades([y for _, _, y in points])

    def at(x: float, y: float) -> tuple[float, float]:
        return (
            left + (width - left - right) * (math.log10(x) - x0) / (x1 - x0),
            height - bottom - (height - top - bottom) * (math.log10(y) - y0) / (y1 - y0),
        )

    parts = []
    for k in range(x0, x1 + 1):
        x, _ = at(10.0**k, 10.0**y0)
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{top}" y2="{height - bottom}" stroke="{GRID}"/>')
        parts.append(_text(x, height - bottom + 15, f"{10.0**k:g}", fill=FAINT, size=11))
    for k in range(y0, y1 + 1):
        _, y = at(10.0**x0, 10.0**k)
        parts.append(f'<line x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}" stroke="{GRID}"/>')
        parts.append(_text(left - 6, y + 4, f"{10.0**k:g}", "end", FAINT, 11))
    for s, (name, px, py) in enumerate(points):
        x, y = at(px, py)
        parts.append(_dot(x, y, 6, colour(s), f"{name}: {px:.3g}, {py:.3g}"))
        parts.append(_text(x + 10, y + 4, name, "start"))
    parts.append(_text((left + width - right) / 2, height - 8, x_title, fill=FAINT))
    parts.append(
        f'<text transform="translate(14 {height / 2:.0f}) rotate(-90)" text-anchor="middle" fill="{FAINT}"'
        f' font-size="12">{escape(y_title)}</text>'
    )
    return _svg(width, height, parts, f"{y_title} against {x_title}")


def _decades(values: Sequence[float]) -> tuple[int, int]:
    logs = [math.log10(value) for value in values if value > 0] or [0.0]
    low, high = math.floor(min(logs)), math.ceil(max(logs))
    return low, max(high, low + 1)


def by_angle(
    series: Sequence[tuple[str, Sequence[tuple[float, float]]]],
    y_title: str,
    width: int = 560,
    height: int = 240,
) -> str:
    """Points (θ in degrees, value) of several series over the polar angle of the light."""
    left, top, bottom = 48, 26, 36
    values = [value for _, points in series for _, value in points] or [0.0, 1.0]
    low, high = math.floor(min(values)), math.ceil(max(values))
    high = max(high, low + 1)
    parts = [_text(left, 14, y_title, "start", FAINT)]
    for k in range(5):
        value = low + (high - low) * k / 4
        y = height - bottom - (height - top - bottom) * k / 4
        parts.append(f'<line x1="{left}" x2="{width}" y1="{y:.1f}" y2="{y:.1f}" stroke="{GRID}"/>')
        parts.append(_text(left - 6, y + 4, f"{value:g}", "end", FAINT, 11))
    for degrees in range(0, 91, 15):
        x = left + (width - left - 10) * degrees / 90
        parts.append(_text(x, height - bottom + 16, f"{degrees}°", fill=FAINT, size=11))
    for s, (name, points) in enumerate(series):
        for theta, value in points:
            x = left + (width - left - 10) * theta / 90
            y = height - bottom - (height - top - bottom) * (value - low) / (high - low)
            parts.append(_dot(x, y, 3.2, colour(s), f"{name}: θ {theta:.0f}°, {value:.2f}"))
        x = left + 90 + s * min(130, (width - left - 90) / len(series))
        parts.append(
            f'<rect x="{x}" y="6" width="10" height="10" fill="{colour(s)}"/>' + _text(x + 15, 15, name, "start")
        )
    parts.append(_text(width / 2, height - 4, "θ of the light", fill=FAINT))
    return _svg(width, height, parts, f"{y_title} over θ")


def swatches(rows: Sequence[tuple[str, str, str, float, str]], columns: int) -> str:
    """Patches of a colour chart: (name, colour as seen, colour as it should be, ΔE00, why it is left out)."""
    wide, high, pad = 92, 58, 8
    width = columns * (wide + pad)
    parts = []
    for k, (name, seen, reference, error, left_out) in enumerate(rows):
        x, y = k % columns * (wide + pad), k // columns * (high + 30)
        for left, fill in ((x, seen), (x + wide / 2, reference)):
            parts.append(f'<rect x="{left}" y="{y}" width="{wide / 2}" height="{high}" fill="{fill}"/>')
        if left_out:
            ends = f'x1="{x}" y1="{y}" x2="{x + wide}" y2="{y + high}"'
            parts += [f'<line {ends} stroke="{ink}" stroke-width="{w}"/>' for ink, w in (("#fff", 4), (INK, 1.5))]
        words = f"{name}: ΔE00 {error:.2f}{f', left out: {left_out}' if left_out else ''}"
        parts.append(
            f'<rect x="{x}" y="{y}" width="{wide}" height="{high}" fill="#0000"><title>{escape(words)}</title></rect>'
        )
        parts.append(_text(x, y + high + 14, f"{error:.1f}{' (left out)' if left_out else ''}", "start", size=11))
    return _svg(width, -(-len(rows) // columns) * (high + 30), parts, "Colour chart: seen beside its reference")
