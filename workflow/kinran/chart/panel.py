"""What the panels of the chart share: axes, numbers, titles."""

import math
from collections.abc import Callable

from kinran.canvas import FAINT, GRID, INK, Canvas, Point

WIDTH, HEIGHT = 680, 480
LEFT, RIGHT, TOP, BOTTOM = 64, 18, 56, 48
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
"""Costs below are drawn here, at the left edge."""

To = Callable[[float, float], Point]


def higher_is_better(measure: str) -> bool:
    """Whether a measure is one of likeness; its axis is linear."""
    return measure.startswith(("psnr", "ssim"))


def axes(canvas: Canvas, xs: list[float], ys: list[float], log_y: bool, right: int = RIGHT) -> To:
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


def titles(canvas: Canvas, x: str, y: str, right: int = RIGHT) -> None:
    """What the axes are: x below, y above the panel's left edge."""
    canvas.text(((LEFT + WIDTH - right) / 2, HEIGHT - 12), x, "middle", FAINT, 12)
    canvas.text((LEFT - 40, 18), y, "start", INK, 13)


def _range(values: list[float], log: bool) -> tuple[float, float]:
    logs = [math.log10(max(v, 1e-6)) for v in values] if log else list(values)
    low, high = (min(logs), max(logs)) if logs else (0.0, 1.0)
    margin = 0.08 * max(high - low, 0.3 if log else 0.05)
    return low - margin, high + margin


def _ticks(low: float, high: float, log: bool) -> list[float]:
    if not log:
        steps = [m * 10.0**k for k in range(-3, 3) for m in (1, 2, 5)]
        step = next(s for s in steps if (high - low) / s <= 8 or s == steps[-1])
        return [round(k * step, 6) for k in range(math.ceil(low / step), math.floor(high / step) + 1)]
    steps = [1.0, 2.0, 5.0] if high - low < 2.2 else [1.0]
    found = [s * 10.0**k for k in range(math.floor(low), math.ceil(high) + 1) for s in steps]
    return [v for v in found if low <= math.log10(v) <= high]
