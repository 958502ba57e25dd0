"""The material that the pipeline wrote, as a method of the chart."""

from pathlib import Path
from typing import Any

import numpy as np

from kinran.chart import experiments, residual
from kinran.chart.method import Fitted, Method
from kinran.chart.methods import linear, takeda
from kinran.chart.rows import Row
from kinran.chart.trial import Trial
from kinran.files import InputError, read_json
from kinran.stack import Stack
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.models import relight

FAMILY = "default"
COSTS = {"microseconds": "microseconds_per_texel", "bytes": "bytes_per_texel", "peak_mb": "peak_mb"}
"""Measures of the chart, and where a summary of the pipeline has them."""


def run(trial: Trial, fabric: str, names: list[str], stack: Stack, material: Path, summary: Path) -> list[Row]:
    """Rows of the default.

    Its errors under all lights are those of the file, its time and bytes those of the pipeline's run. Memory, and
    the errors with less, are measured on its model fitted again to the trial.
    """
    maps = read_material(material)
    if maps.size != (stack.height, stack.width):
        raise InputError(f"{material}: its size is not that of {stack.path}; fit it again")
    known: dict[str, Any] = read_json(summary)
    method = Method(f"default ({known.get('model', maps.model)})", FAMILY, lambda t: _again(t, maps), 4, True)
    _, cost = experiments.measure(method, trial)
    for name, key in COSTS.items():
        if key in known:
            cost[name] = float(known[key])
    height, width = trial.shape
    y, x = (stack.height - height) // 2, (stack.width - width) // 2
    images = relight(maps.part(slice(y, y + height), slice(x, x + width)), trial.held_out)
    predicted = np.ascontiguousarray(images.reshape(len(images), -1, 3).transpose(1, 2, 0))
    rows = [experiments.floor(trial, fabric)]
    rows += experiments.judged(fabric, method, predicted, trial, names, cost)
    return [*rows, *experiments.with_less(trial, fabric, method)]


def _again(trial: Trial, maps: Material) -> Fitted:
    """The material's model, fitted to a trial."""
    if maps.model == "slope":
        kept = maps.residual
        return residual.fit(trial, maps.tail, maps.lobes, *((kept.count, kept.share) if kept else (0,)))
    return (linear.METHODS[0] if maps.model == "lambert" else takeda.METHODS[0]).fit(trial)
