"""The material that the pipeline wrote, as a method of the chart."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kinran.base.files import InputError, read_json
from kinran.compare import experiments, lobes_and_residual
from kinran.compare.method import Method
from kinran.compare.methods import takeda
from kinran.compare.rows import Row
from kinran.compare.trial import Single, Trial, by_texel, middle
from kinran.data import material_prediction
from kinran.data.fabric import Fabric
from kinran.data.radiance_stack import Stack
from kinran.fit import lambert
from kinran.fit.fitted_model import Fitted
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.material import Material, read_material

FAMILY = "default"
COSTS = {"microseconds": "microseconds_per_texel", "bytes": "bytes_per_texel", "peak_mb": "peak_mb"}
"""Names of the chart's costs, and the names that a summary of the pipeline has for them."""


def run(tried: Trial, name: str, fabric: Fabric, material: Path, summary: Path) -> list[Row]:
    """Rows of the default.

    The errors under all lights are those of the file, time and bytes those of the pipeline's run. Memory, and errors
    with fewer lights or exposures, are measured on the model, which is fitted again to the trial.

    Parameters
    ----------
    tried
        Trial of the fabric.
    name
        Name of the fabric in the rows.
    material, summary
        Material (.exr) and summary (.json) that the pipeline wrote.

    Raises
    ------
    InputError
        The material is not of the size of the fabric.
    """
    maps = read_material(material)
    if maps.size != (fabric.stack.height, fabric.stack.width):
        raise InputError(f"{material}: its size is not that of {fabric.stack_path}; fit it again")
    known: dict[str, Any] = read_json(summary)
    title = f"default ({known.get('model', maps.model)})"
    method = Method(title, FAMILY, lambda t: AGAIN[maps.model](t, maps), swept=True)
    _, cost = experiments.measure(method, tried)
    cost |= {measure: float(known[key]) for measure, key in COSTS.items() if key in known}
    rows = [experiments.floor(tried, name)]
    rows += experiments.judged(name, method, said(maps, fabric.stack), tried, cost)
    return [*rows, *experiments.with_less(tried, name, method)]


def said(material: Material, stack: Stack) -> Single:
    """Prediction (texel, 3, light) of a material under the held-out lights, for the texels of a stack's trial."""
    return by_texel(material_prediction.predict(material, stack, middle(stack), np.flatnonzero(stack.held_out)))


def _slope(tried: Trial, maps: Material) -> Fitted:
    """The material's lobes, and its residual where it has one."""
    count, share = (maps.residual.count, maps.residual.share) if maps.residual else (0, 1.0)
    return lobes_and_residual.fit(tried, Lobes(maps.tail, maps.lobes), count, share)


AGAIN: dict[str, Callable[[Trial, Material], Fitted]] = {
    "slope": _slope,
    "takeda2008": lambda tried, _: takeda.four_steps(tried),
    "lambert": lambda tried, _: lambert.fit(tried.samples),
}
"""Functions that fit the model of a material to a trial, by the name of the model."""
