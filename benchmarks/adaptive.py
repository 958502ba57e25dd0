"""Error by the number of directions: of a grid, at random, spread evenly, and where the fit so far is least sure.

Every plan chooses among the same directions of a set, and is judged by the same others, which none can choose. Each is
fitted as the pipeline fits so many lights.
"""

import argparse
import logging
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks import chart, fit, real_sets, stages
from kinran.base import frames
from kinran.base.apart import spread
from kinran.base.drawing import axes, plots
from kinran.base.drawing.canvas import Canvas, write
from kinran.base.files import InputError, write_json
from kinran.base.log import progress
from kinran.base.project import ROOT
from kinran.compare import errors
from kinran.compare.fitted_lobes import of_present_regions
from kinran.compare.trial import Trial
from kinran.compare.trial import read as read_trial
from kinran.data.fabric import Fabric
from kinran.fit import design, learned_priors, under_priors
from kinran.fit.few_lights import FEW_LIGHTS
from kinran.fit.region_priors import Priors
from kinran.fit.samples import Samples, spread_over_regions
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

COUNTS = (16, 24, 32, 48, 64, 96, 128, 192, 256)
"""Numbers of directions that are compared, up to those of a set. Choices."""
TEXELS = 300
"""Texels of a set, evenly through its middle. A choice: a set then takes a minute."""
SEEDS = 3
"""Random choices of directions. A choice."""
ASPECT = 16 / 24
"""Rings of a grid over its azimuths, those of config.yaml."""
PLANS = ("grid", "random", "spread", "adaptive")
BROCADE = "brocade"
OFFSETS = {"item3": (4, 0, 2, 6), "item5": (4, 0), "item11": (4, 0), "densePS": (4, 0)}
"""Sets whose held-out lights are taken from several places of the list, of which every eighth is held out: with some
ten lights held out, one choice of them decides too much."""
SIZE = (560, 340)


@dataclass(frozen=True)
class Point:
    """Errors of a plan with so many directions, on one choice of held-out lights.

    Attributes
    ----------
    seed
        Of the plan's random choice, or the place of the held-out lights.
    relative, display
        Relative error, and the root mean squared error of displayed values: that of a PSNR.
    """

    plan: str
    count: int
    seed: str
    relative: float
    display: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the real sets")
    known = ", ".join([BROCADE, *real_sets.sets()])
    parser.add_argument("--sets", nargs="+", default=[BROCADE, "item3", "densePS"], help=f"which of {known}")
    parser.add_argument("--plans", nargs="+", default=PLANS, choices=PLANS, help="which plans (default: all)")
    parser.add_argument("--cache", type=Path, default=fit.CACHE, help="where rendered lights are kept")
    parser.add_argument("--out", type=Path, required=True, help="results (.json), beside a drawing (.svg, .png)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table of each set, write JSON and the drawing."""
    known = real_sets.sets()
    for name in args.sets:
        if name not in (BROCADE, *known):
            raise InputError(f"--sets {name}: is none of {', '.join([BROCADE, *known])}")
    found: dict[str, list[Point]] = {}
    for name in args.sets:
        found[name] = []
        for offset, trial in trials(name, args.data, args.cache):
            found[name] += measure(trial, offset, args.plans)
            write_json(args.out, {of: [asdict(point) for point in points] for of, points in found.items()})
        print(table(name, found[name]), flush=True)
    drawn = draw(found)
    for suffix in (".svg", ".png"):
        write(args.out.with_suffix(suffix), drawn)


def trials(name: str, data: Path, cache: Path) -> Iterator[tuple[str, Trial]]:
    """Trials of a set, one for each choice of its held-out lights."""
    if name == BROCADE:
        scene = fit.truth(cache)
        yield "0", _trial(lambda folder: chart.write_stack(scene, folder))
        return
    real = real_sets.sets()[name](data)
    for offset in OFFSETS.get(name, (0,)):
        held = np.arange(len(real.held)) % real_sets.EVERY == offset if name in OFFSETS else real.held
        yield str(offset), _trial(replace(real, held=held).write)


def _trial(write_stack: Callable[[Path], None]) -> Trial:
    with tempfile.TemporaryDirectory() as folder, stages.quiet():
        write_stack(Path(folder) / "radiance.zarr")
        stages.segmented(Path(folder))
        return read_trial(Fabric(Path(folder))).thinned(TEXELS)


def measure(trial: Trial, offset: str, plans: tuple[str, ...] = PLANS) -> list[Point]:
    """Errors of plans with 16 directions and more, up to all that a trial has."""
    trial = replace(trial, samples=of_present_regions(trial.samples))
    directions = trial.samples.under.directions
    counts = [count for count in COUNTS if count < len(directions)]
    points = []

    def judge(plan: str, count: int, seed: str, use: Indices) -> None:
        less = trial.under(np.sort(use))
        predicted = less.measured(fitted(less.samples)[0])
        display = float(np.mean(10 ** (-errors.psnr(predicted, trial) / 20)))
        relative = errors.ratio_of(*errors.squares(predicted, trial))
        points.append(Point(plan, count, seed, round(relative, 5), round(display, 5)))

    for count in progress(counts, "bench adaptive", "numbers of directions"):
        if "grid" in plans:
            judge("grid", count, offset, grid(directions, count))
        if "random" in plans:
            for seed in range(SEEDS):
                rng = np.random.default_rng(seed)
                judge("random", count, f"{offset}.{seed}", rng.permutation(len(directions))[:count])
        if "spread" in plans:
            judge("spread", count, offset, spread(directions, count))
    if "adaptive" in plans:
        chosen = adaptive(trial, counts[-1])
        for count in counts:
            judge("adaptive", count, offset, chosen[:count])
    return points


def fitted(samples: Samples) -> tuple[SlopeFit, Lobes, Priors]:
    """Fit samples as the pipeline does, with priors of as many texels as it takes."""
    lobes = lobes_for(samples.under.count)
    regions = int(samples.region.max()) + 1
    some = np.flatnonzero(spread_over_regions(samples.region, regions, learned_priors.SAMPLE))
    priors = under_priors.learn(samples.of(some), regions, lobes)
    return under_priors.fit(samples.weighed(priors.lights), lobes, priors), lobes, priors


def lobes_for(lights: int) -> Lobes:
    """Lobes of so many lights: those of config.yaml, but one of GGX for few."""
    known = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))["fit"]
    return Lobes("ggx", 1) if lights < FEW_LIGHTS else Lobes(known["tail"], known["lobes"])


def grid(directions: Array, count: int) -> Indices:
    """Directions nearest to a grid of so many: the normal, and rings of equal azimuths down to the lowest light."""
    lowest = float(np.arccos(directions[:, 2].min()))
    rings = max(2, round(float(np.sqrt((count - 1) * ASPECT))))
    wanted, left = [frames.direction(0, 0)], count - 1
    for k in range(rings):
        azimuths = round(left / (rings - k))
        left -= azimuths
        wanted += list(frames.direction(lowest * (k + 1) / rings, 2 * np.pi * np.arange(azimuths) / azimuths))
    nearness = np.array(wanted) @ directions.T
    chosen: list[int] = []
    for row in nearness:
        row[chosen] = -np.inf
        chosen.append(int(row.argmax()))
    return np.array(chosen, np.intp)


def adaptive(trial: Trial, count: int) -> Indices:
    """Directions that the optimal design chooses, batch by batch, each from what was taken alone."""
    directions = trial.samples.under.directions
    chosen = spread(directions, COUNTS[0])
    while len(chosen) < count:
        batch = min(design.batch(len(chosen)), count - len(chosen))
        left = np.setdiff1d(np.arange(len(directions)), chosen)
        some = trial.under(chosen).samples
        _, lobes, priors = fitted(some)
        at = np.linspace(0, len(some) - 1, min(design.TEXELS, len(some))).astype(np.intp)
        found = design.propose(some.of(at), lobes, priors, directions[left], directions, batch, np.ones(len(at)))
        chosen = np.concatenate([chosen, left[found.chosen]])
    return chosen


def _means(points: list[Point], measure: str) -> dict[str, dict[int, tuple[float, float]]]:
    """Geometric mean of an error, and its spread as a factor, by plan and number of directions."""
    result: dict[str, dict[int, tuple[float, float]]] = {}
    for point in points:
        result.setdefault(point.plan, {})[point.count] = (0.0, 0.0)
    for plan, by_count in result.items():
        for count in by_count:
            logs = [np.log(max(getattr(p, measure), axes.LEAST)) for p in points if (p.plan, p.count) == (plan, count)]
            by_count[count] = (float(np.exp(np.mean(logs))), float(np.exp(np.std(logs))))
    return result


def needed(curve: dict[int, tuple[float, float]], error: float) -> float:
    """Fewest directions with which a curve is at or under an error, interpolated; infinite if it never is."""
    last = None
    for count, (value, _) in sorted(curve.items()):
        if value <= error:
            if last is None or last[1] <= value:
                return float(count)
            part = np.log(last[1] / error) / np.log(last[1] / value)
            return float(np.exp(np.log(last[0]) + part * np.log(count / last[0])))
        last = (count, value)
    return np.inf


def table(name: str, points: list[Point]) -> str:
    """Errors of a set by plan, and the directions that the adaptive plan needs for the grid's error."""
    lines = []
    for measure in ("relative", "display"):
        means = _means(points, measure)
        counts = sorted({point.count for point in points})
        lines.append(f"{name}, {measure} error" + "".join(f"{count:>14d}" for count in counts))
        for plan, curve in means.items():
            cells = [f"{curve[c][0]:8.4f} ×{curve[c][1]:4.2f}" if c in curve else "" for c in counts]
            lines.append(f"  {plan:18s}" + "".join(f"{cell:>14s}" for cell in cells))
        if {"grid", "adaptive"} <= set(means):
            cells = [f"{needed(means['adaptive'], means['grid'][c][0]):.0f}" for c in counts]
            lines.append(f"  {'for the grid’s error':18s}" + "".join(f"{cell:>14s}" for cell in cells))
    return "\n".join(lines)


def draw(found: dict[str, list[Point]]) -> Canvas:
    """Draw the errors of each set over the number of directions: relative for radiance, displayed for photographs."""
    canvas = Canvas(SIZE[0] * len(found), SIZE[1])
    for k, (name, points) in enumerate(found.items()):
        measure, words = ("relative", "relative error") if name == BROCADE else ("display", "error of displayed values")
        means = _means(points, measure)
        series = [
            plots.Series(
                plan,
                plots.colour(PLANS[::-1].index(plan)),
                [(count, value, f"{plan}, {count}: {value:.3g}") for count, (value, _) in sorted(means[plan].items())],
                bold=plan == "adaptive",
            )
            for plan in PLANS[::-1]
            if plan in means
        ]
        counts = sorted({point.count for point in points})
        x = axes.logarithmic("number of directions", counts)
        x = replace(x, ticks=tuple((count, str(count)) for count in counts))
        y = axes.logarithmic(f"{name}: {words}", [value for plan in means.values() for value, _ in plan.values()])
        canvas.paste(plots.lines(series, x, y, SIZE), SIZE[0] * k, 0)
    return canvas
