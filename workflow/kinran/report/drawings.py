"""Drawings of the report: lights, errors, costs, times, and the patches of a colour chart."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinran.base.drawing import axes, plots
from kinran.base.drawing.canvas import FAINT, GRID, INK, Canvas
from kinran.data.capture_plan import Plan

Values = dict[str, Any]

SKY, RADIUS = 360, 160
"""Width of the drawing of lights and radius of its horizon, in pixels."""
PATCH = (92, 58)
"""Width and height of a patch, in pixels."""
BETWEEN = (8, 30)
"""Pixels between patches: across, and down with the line of text."""


def lights(plan: Plan, held_out: Sequence[str]) -> Canvas:
    """Light directions as the camera sees them; the rim is the horizon, and rings are held out."""
    canvas, centre, held = Canvas(SKY, SKY), SKY / 2, set(held_out)

    def at(theta: float, phi: float) -> tuple[float, float]:
        r = RADIUS * theta / 90
        return centre + r * math.cos(math.radians(phi)), centre - r * math.sin(math.radians(phi))

    for theta in (30, 60, 90):
        canvas.line([at(theta, phi) for phi in range(0, 361, 5)], GRID)
    for theta in (30, 60):
        canvas.text((centre + 3, at(theta, 90)[1] + 12), f"{theta}°", colour=FAINT, size=10)
    for light in plan.lights:
        words = f"{light.name}: θ {light.theta:.0f}°, φ {light.phi:.0f}°"
        place = at(light.theta, light.phi)
        if light.name in held:
            canvas.dot(place, plots.colour(1), 3.6, f"{words}, held out", ring=True)
        else:
            canvas.dot(place, plots.colour(0), 2.6, words)
    canvas.text((at(90, 0)[0] + 10, centre + 4), "X", "middle", FAINT)
    canvas.text((centre, at(90, 90)[1] - 6), "Y", "middle", FAINT)
    return canvas


def by_region(errors: Values, judged: Values) -> Canvas:
    """Relative error of each method in each region."""
    groups = []
    for region in errors["regions"]:
        values = [(name, method["regions"][region]["relative_error"]) for name, method in judged.items()]
        bars = [plots.Bar(name, value, f"{value:.3g}", plots.colour(k)) for k, (name, value) in enumerate(values)]
        groups.append((region, bars))
    return plots.bars(groups, 420, "relative error")


def by_angle(judged: Values, plan: Plan) -> Canvas:
    """PSNR of each method under each held-out light, over the light's θ."""
    theta = {light.name: light.theta for light in plan.lights}
    series = []
    for k, (name, method) in enumerate(judged.items()):
        at = [(theta[light], error["psnr"]) for light, error in method["lights"].items()]
        points = [(x, y, f"{name}: θ {x:.0f}°, {y:.2f} dB") for x, y in at]
        series.append(plots.Series(name, plots.colour(k), points, joined=False))
    x = axes.Axis("θ of the light", 0, 90, tuple((float(v), f"{v}°") for v in range(0, 91, 15)))
    y = axes.linear("PSNR, dB", [psnr for one in series for _, psnr, _ in one.points])
    return plots.lines(series, x, y, (560, 340))


def against_time(errors: Values) -> Canvas | None:
    """Error of each method against the time of its fit; None where none was judged."""
    dots = []
    for k, (name, method) in enumerate(errors["methods"].items()):
        time, error = max(method["fit"]["microseconds_per_texel"], 0.01), method.get("relative_error", 0)
        if error > 0:
            dots.append(plots.Dot(time, error, name, plots.colour(k), f"{name}: {time:.3g} µs, {error:.3g}"))
    if not dots:
        return None
    x = axes.logarithmic("fit, µs CPU a texel", [dot.x for dot in dots])
    y = axes.logarithmic("relative error, held-out lights", [dot.y for dot in dots])
    return plots.scatter(dots, x, y, (480, 340))


def stages(folder: Path) -> Canvas:
    """Seconds of each stage from the benchmark files of its jobs, the longest first, and the memory of the largest."""
    seconds: dict[str, float] = {}
    memory: dict[str, float] = {}
    for path in sorted(folder.glob("*.tsv")):
        stage = path.name.split(".")[0]
        with path.open(newline="") as file:
            for row in csv.DictReader(file, delimiter="\t"):
                seconds[stage] = seconds.get(stage, 0) + float(row["s"])
                try:
                    memory[stage] = max(memory.get(stage, 0), float(row["max_rss"]))
                except ValueError:  # a job too short to be measured
                    continue
    rows = sorted(seconds.items(), key=lambda item: -item[1])
    texts = {stage: f", {size:.0f} MB" for stage, size in memory.items()}
    return plots.bars([("", [plots.Bar(stage, s, f"{s:.1f} s{texts.get(stage, '')}") for stage, s in rows])], 560)


def swatches(rows: Sequence[tuple[str, str, str, float, str]], columns: int) -> Canvas:
    """Patches of a colour chart: (name, colour as seen, colour as it should be, ΔE00, why it is left out)."""
    (wide, high), (across, down) = PATCH, BETWEEN
    canvas = Canvas(columns * (wide + across), -(-len(rows) // columns) * (high + down))
    for k, (name, seen, reference, error, left_out) in enumerate(rows):
        x, y = k % columns * (wide + across), k // columns * (high + down)
        canvas.box((x, y), (x + wide / 2, y + high), seen)
        canvas.box((x + wide / 2, y), (x + wide, y + high), reference)
        if left_out:
            canvas.line([(x, y), (x + wide, y + high)], "#ffffff", 4)
            canvas.line([(x, y), (x + wide, y + high)], INK, 1.5)
        words = f"{name}: ΔE00 {error:.2f}{f', left out: {left_out}' if left_out else ''}"
        canvas.box((x, y), (x + wide, y + high), "#0000", words)
        canvas.text((x, y + high + 14), f"{error:.1f}{' (left out)' if left_out else ''}", size=11)
    return canvas
