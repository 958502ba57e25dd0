"""The experiments of the chart: every method on all lights, then some with less."""

import sys
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinran.chart import errors, meter
from kinran.chart.methods import Method, methods
from kinran.chart.rows import Row
from kinran.chart.trial import Samples, Trial, spread

DIRECTIONS = (300, 100, 50, 30, 16)
THIN = 2000
"""Texels that the experiments with less light are made with."""
EXTRAPOLATE_FROM = 50.0
LEAST_EXPOSURES = 2
WARM = 24


def run(trial: Trial, fabric: str, names: list[str], default: tuple[str, Samples, dict[str, float]]) -> list[Row]:
    """All rows of a fabric.

    Parameters
    ----------
    trial
        Its samples.
    names
        Of its regions.
    default
        Name of the default material, what it predicts (texel, 3, light), and what it cost.
    """
    n = trial.lights.shape[0]
    floor = 1e6 * trial.T[0].nbytes / meter.bandwidth()
    judged = "psnr_display" if trial.coder else "relative_error"
    rows = [Row(fabric, "floor", judged, "read the samples once", "floor", n, {"microseconds": floor})]
    name, predicted, cost = default
    rows += _judged(fabric, (name, "default"), predicted, trial, names, cost)
    for method in methods():
        if n >= method.least_lights:
            rows += _whole(fabric, method, trial, names)
    thin = trial.thinned(THIN)
    for count in (n, *(c for c in DIRECTIONS if c < n)):
        rows += _swept(fabric, "directions", str(count), thin.under(spread(thin.lights, count)), thin)
    if trial.clips:
        for kept in range(len(trial.clips), LEAST_EXPOSURES - 1, -1):
            rows += _swept(fabric, "exposures", str(kept), thin.with_exposures(kept), thin)
    rows += _extrapolated(fabric, thin)
    return rows


def _whole(fabric: str, method: Method, trial: Trial, names: list[str]) -> list[Row]:
    method.fit(trial.thinned(WARM))  # compiles
    fitted, cost = meter.measure(lambda: method.fit(trial))
    values = {
        "microseconds": 1e6 * cost.seconds / trial.texels,
        "bytes": fitted.bytes_per_texel(trial.texels),
        **({"memory_mb": cost.memory} if cost.memory >= 0 else {}),
    }
    return _judged(fabric, (method.name, method.family), fitted.predict(trial.held_out), trial, names, values)


def _judged(
    fabric: str, who: tuple[str, str], predicted: Samples, trial: Trial, names: list[str], cost: dict[str, float]
) -> list[Row]:
    values = {**errors.summary(predicted, trial), **cost}
    took = f", {cost['microseconds']:.3g} µs a texel" if "microseconds" in cost else ""
    print(f"{who[0]}: relative error {values['relative_error']:.3f}{took}", file=sys.stderr, flush=True)
    n = trial.lights.shape[0]
    rows = [Row(fabric, "all", "", *who, n, values)]
    for experiment, parts in (
        ("theta", errors.by_band(predicted, trial)),
        ("region", errors.by_region(predicted, trial, names)),
    ):
        for setting, value in parts.items():
            rows.append(Row(fabric, experiment, setting, *who, n, {"relative_error": value}))
    return rows


def _swept(fabric: str, experiment: str, setting: str, less: Trial, judge: Trial) -> Iterator[Row]:
    """Rows of the methods that can do with what `less` has, judged by the held-out samples of `judge`."""
    n = less.lights.shape[0]
    print(f"{experiment} {setting}", file=sys.stderr, flush=True)
    for method in methods():
        if method.swept and n >= method.least_lights:
            values = errors.summary(method.fit(less).predict(judge.held_out), judge)
            yield Row(fabric, experiment, setting, method.name, method.family, n, values)


def _extrapolated(fabric: str, trial: Trial) -> list[Row]:
    """Rows by band of θ of methods that saw lights within 50° of the normal alone."""
    use: NDArray[np.intp] = np.flatnonzero(trial.lights[:, 2] >= np.cos(np.radians(EXTRAPOLATE_FROM + 0.1)))
    rows: list[Row] = []
    if len(use) == len(trial.lights):
        return rows
    near = trial.under(use)
    print(f"extrapolation from θ ≤ {EXTRAPOLATE_FROM:g}°", file=sys.stderr, flush=True)
    for method in methods():
        if method.swept and len(use) >= method.least_lights:
            parts = errors.by_band(method.fit(near).predict(trial.held_out), trial)
            for setting, value in parts.items():
                values = {"relative_error": value}
                rows.append(Row(fabric, "extrapolation", setting, method.name, method.family, len(use), values))
    return rows
