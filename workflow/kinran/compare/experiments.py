"""The experiments of the chart: a method on all lights, then with fewer lights or exposures."""

import logging
from collections.abc import Iterable, Iterator
from itertools import pairwise

import numpy as np

from kinran.base.apart import spread
from kinran.compare import errors, meter
from kinran.compare.method import NUMBER, Method, bytes_per_texel
from kinran.compare.rows import Row
from kinran.compare.trial import Single, Trial

log = logging.getLogger(__name__)

DIRECTIONS = (300, 100, 50, 30, 16)
"""Numbers of lights that methods are given. A choice: from a goniometer's down to fewer than a small dome has."""
SOME, SAMPLES = 600, 200_000
"""Fewest texels, and number of samples, of experiments with fewer lights: few lights allow more texels. Choices."""
EXTRAPOLATE_FROM = 50.0
"""Degrees of θ up to which lights are seen where the steeper ones are judged. A choice: a band ends there."""
LEAST_EXPOSURES = 2
"""Fewest exposures that are tried: one is no bracket."""
WARM = 24
"""Texels that a method is fitted to before the clock starts: code is compiled for types, whatever the size."""


def run(trial: Trial, fabric: str, methods: Iterable[Method]) -> list[Row]:
    """Rows of methods on the trial of a fabric of this name, the floor first."""
    rows = [floor(trial, fabric)]
    for method in methods:
        if len(trial.lights) >= method.least_lights:
            predicted, cost = measure(method, trial)
            rows += judged(fabric, method, predicted, trial, cost)
        if method.swept:
            rows += with_less(trial, fabric, method)
    return rows


def floor(trial: Trial, fabric: str) -> Row:
    """Row of the time to read a texel's training samples once; its setting is the measure of the front."""
    judge = "psnr_display" if trial.coder else "relative_error"
    microseconds = 1e6 * trial.samples.T[0].nbytes / meter.bandwidth()
    values = {"microseconds": microseconds}
    return Row(fabric, "floor", judge, "read the samples once", "floor", len(trial.lights), values)


def measure(method: Method, trial: Trial) -> tuple[Single, dict[str, float]]:
    """Fit a method to the whole trial, and return predictions under the held-out lights and costs."""
    method.fit(trial.thinned(WARM))  # compiles
    fitted, cost = meter.measure(lambda: method.fit(trial))
    size = bytes_per_texel(fitted, trial.texels)
    values = {
        "microseconds": 1e6 * cost.seconds / trial.texels,
        "bytes": size,
        "peak_mb": cost.peak,
        **({"memory_mb": cost.memory} if cost.memory >= 0 else {}),
        **errors.criteria(fitted.predict(trial.samples.under), trial, size / NUMBER),
    }
    return trial.measured(fitted), values


def judged(fabric: str, method: Method, predicted: Single, trial: Trial, cost: dict[str, float]) -> list[Row]:
    """Rows of a prediction under all lights: as a whole, by band of θ and by region."""
    values = {**errors.summary(predicted, trial), **cost}
    took = f", {cost['microseconds']:.3g} µs a texel" if "microseconds" in cost else ""
    log.info("%s: relative error %.3f%s", method.name, values["relative_error"], took)
    n = len(trial.lights)
    rows = [Row(fabric, "all", "", method.name, method.family, n, values)]
    for experiment, parts in (
        ("theta", errors.by_band(predicted, trial)),
        ("region", errors.by_region(predicted, trial)),
    ):
        for setting, value in parts.items():
            rows.append(Row(fabric, experiment, setting, method.name, method.family, n, {"relative_error": value}))
    return rows


def with_less(trial: Trial, fabric: str, method: Method) -> Iterator[Row]:
    """Rows of a method with fewer directions, fewer exposures, and without some rings of θ."""
    n = len(trial.lights)

    def row(experiment: str, setting: str, less: Trial, values: dict[str, float]) -> Row:
        return Row(fabric, experiment, setting, method.name, method.family, len(less.lights), values)

    for count in (n, *(c for c in DIRECTIONS if c < n)):
        if count >= method.least_lights:
            some = trial.thinned(max(SOME, SAMPLES // count))
            less = some.under(np.sort(spread(some.samples.under.directions, count)))
            yield row("directions", str(count), less, errors.summary(_predict(method, less), some))
    some = trial.thinned(SOME)
    for kept in range(len(trial.clips), LEAST_EXPOSURES - 1, -1):
        if n >= method.least_lights:
            less = some.with_exposures(kept)
            yield row("exposures", str(kept), less, errors.summary(_predict(method, less), some))
    theta = np.degrees(np.arccos(np.clip(trial.samples.under.directions[:, 2], -1, 1)))
    for low, high in pairwise(errors.BANDS):
        less = some.under(np.flatnonzero((theta < low) | (theta >= high)))
        if method.least_lights <= len(less.lights) < n:
            parts = errors.by_band(_predict(method, less), some)
            label = errors.band(low, high)
            if label in parts:
                yield row("ring", label, less, {"relative_error": parts[label]})
    near = some.under(np.flatnonzero(theta <= EXTRAPOLATE_FROM + 0.1))
    if method.least_lights <= len(near.lights) < n:
        for setting, value in errors.by_band(_predict(method, near), some).items():
            yield row("extrapolation", setting, near, {"relative_error": value})


def _predict(method: Method, trial: Trial) -> Single:
    return trial.measured(method.fit(trial))
