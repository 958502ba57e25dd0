"""Error of each fitted material on the held-out lights, by region and by light."""

import logging
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.base.files import InputError, read_json, write_json
from kinran.data import material_prediction, metrics
from kinran.data.fabric import Fabric
from kinran.data.held_out_photographs import HeldOut
from kinran.data.labels import LabelMap, Region
from kinran.data.radiance_stack import Stack
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import read_material

log = logging.getLogger(__name__)

Images = NDArray[np.float32]

SHOWN = 3
"""Held-out lights in the picture: the brightest, the darkest and the one between them."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    materials: Annotated[tuple[Path, ...], "MODEL.exr beside its MODEL.json; the first is the default"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    errors: Annotated[Path, "OUT", "errors (.json)"]
    picture: Annotated[Path, "held-out photographs beside predictions (.png)"]


@dataclass(frozen=True)
class Options:
    """Name that the errors are filed under."""

    name: Annotated[str, "name of the fabric"]


def main(inputs: Inputs, out: Outputs, options: Options) -> None:
    """Write the errors of all materials; the first one is the default.

    Raises
    ------
    InputError
        A material is not of the size of the fabric.
    """
    fabric = Fabric(inputs.fabric)
    stack = fabric.stack
    result: dict[str, Any] = {
        "fabric": options.name,
        "default": inputs.materials[0].stem,
        "unit": stack.unit,
        "psnr_of": stack.encoding or f"log(1 + {metrics.LOG_COMPRESSION:g} x / p99.9)",
        "training_lights": int((~stack.held_out).sum()),
        "held_out": [light.name for light in stack.lights if light.held_out],
        "regions": {region.name: region.texels for region in fabric.regions},
        "methods": {},
    }
    if stack.held_out.any():
        held = HeldOut.read(stack)
        predictions = {}
        for path in inputs.materials:
            start = time.process_time()
            predicted = _predicted(path, stack, held)
            seconds = time.process_time() - start
            predictions[path.stem] = predicted
            errors = errors_of(held, predicted, fabric.labels, fabric.regions)
            result["methods"][path.stem] = {**errors, "relight_cpu_seconds": round(seconds, 3)}
            log.info("%s: %.2f dB, relative %.3f", path.stem, errors["psnr"], errors["relative_error"])
        picture = _picture(predictions, held, stack)
    else:
        empty = np.full((40, 360, 3), 250, np.uint8)
        picture = pictures.sheet([[("no light was held out: there is nothing to judge by", empty)]])
    for path in inputs.materials:
        result["methods"].setdefault(path.stem, {})["fit"] = read_json(path.with_suffix(".json"))
    pictures.write_png(out.picture, picture)
    write_json(out.errors, result)


def errors_of(held: HeldOut, predicted: Images, labels: LabelMap, regions: list[Region]) -> dict[str, Any]:
    """Errors of a prediction (light, y, x, 3): over all texels and lights, by region, by light and by texel."""
    n = len(held.lights)
    p, g, v = (a.reshape(n, -1, 3) for a in (predicted, held.truth, held.valid))
    dp, dg = held.shown(p), held.shown(g)
    weight = held.share

    def over(inside: NDArray[np.bool_] | slice) -> dict[str, float]:
        by_light = [metrics.psnr(dp[i][inside], dg[i][inside], v[i][inside]) for i in range(n)]
        relative = metrics.relative_error(p[:, inside], g[:, inside], v[:, inside], weight)
        return {
            "relative_error": round(relative, 5),
            "psnr": round(float(np.mean(by_light)), 3),
            "psnr_min": round(float(np.min(by_light)), 3),
        }

    def of_light(i: int) -> dict[str, float]:
        one = slice(i, i + 1)
        return {
            "psnr": round(metrics.psnr(dp[i], dg[i], v[i]), 3),
            "relative_error": round(metrics.relative_error(p[one], g[one], v[one], np.ones(1)), 5),
        }

    w = weight[:, None, None] * v
    texel = np.sqrt((w * (p - g) ** 2).sum((0, 2)) / np.maximum((w * g**2).sum((0, 2)), 1e-12))
    return {
        **over(slice(None)),
        "texel_median": round(float(np.median(texel)), 5),
        "texel_p95": round(float(np.percentile(texel, 95)), 5),
        "texels_above_1": round(float((texel > 1).mean()), 6),
        "regions": {r.name: {**over(labels.reshape(-1) == r.label), "texels": r.texels} for r in regions},
        "lights": {light.name: of_light(i) for i, light in enumerate(held.lights)},
    }


def _predicted(path: Path, stack: Stack, held: HeldOut) -> Images:
    """Prediction (light, y, x, 3) of a material under the held-out lights, in the unit of the stack."""
    material = read_material(path)
    if material.channels["label"].shape != held.truth.shape[1:3]:
        raise InputError(f"{path}: its size is not that of {stack.path}; fit it again")
    predicted = np.zeros_like(held.truth)
    for box in stack.tiles():
        predicted[:, box[0] : box[1], box[2] : box[3]] = material_prediction.predict(material, stack, box, held.use)
    return predicted


def _picture(predictions: dict[str, Images], held: HeldOut, stack: Stack) -> pictures.Picture:
    """Rows of held-out lights: the photograph, then each prediction and its error."""
    truth = held.truth
    to_rec709 = TO_REC709 @ stack.to_acescg

    def shown(image: Images, exposure: float, size: int) -> pictures.Picture:
        light = np.asarray(image @ to_rec709.T, np.float32)
        return pictures.enlarge(pictures.photograph(light, exposure), size)

    energy = truth.mean((1, 2, 3))
    order = np.argsort(-energy)
    chosen = order[np.linspace(0, len(order) - 1, min(SHOWN, len(order))).astype(int)]
    rows = []
    for i in chosen:
        exposure = 1.0 if held.coder else pictures.auto_exposure(truth[i] @ to_rec709.T)
        size = max(160, min(240, truth.shape[2]))
        row = [(held.lights[i].name, shown(truth[i], exposure, size))]
        for name, predicted in predictions.items():
            row.append((name, shown(predicted[i], exposure, size)))
            error = held.shown(predicted[i]) - held.shown(truth[i])
            heat = pictures.heat(np.abs(error).mean(-1), 0.25)
            row.append((f"{name}: error, to 0.25", pictures.enlarge(heat, size)))
        rows.append(row)
    return pictures.sheet(rows)
