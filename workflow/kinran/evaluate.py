"""Error of each fitted material on the held-out lights, by region and by light."""

import argparse
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran import encoding, metrics, pictures, prediction
from kinran.files import InputError, read_json, write_json
from kinran.labels import LabelMap, Region, read_labels, read_regions
from kinran.stack import HOT, SATURATED, SHIFTED, Light, Stack
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import read_material

Images = NDArray[np.float32]

SHOWN = 3
"""Held-out lights in the picture: the brightest, the darkest and the one between them."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--fabric", required=True)
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--materials", type=Path, nargs="+", required=True, help="MODEL.exr beside its MODEL.json")
    parser.add_argument("--picture", type=Path, required=True, help="held-out photographs beside predictions (.png)")
    parser.add_argument("out", type=Path, help="errors (.json)")


def main(args: argparse.Namespace) -> None:
    """Write the errors of all materials; the first one is the default."""
    stack = Stack.open(args.stack)
    labels = read_labels(args.labels)
    regions = read_regions(args.regions)
    result: dict[str, Any] = {
        "fabric": args.fabric,
        "default": args.materials[0].stem,
        "unit": stack.unit,
        "psnr_of": stack.encoding or f"log(1 + {metrics.LOG_COMPRESSION:g} x / p99.9)",
        "training_lights": sum(not light.held_out for light in stack.lights),
        "held_out": [light.name for light in stack.lights if light.held_out],
        "regions": {region.name: region.texels for region in regions},
        "methods": {},
    }
    use = np.array([i for i, light in enumerate(stack.lights) if light.held_out], np.intp)
    if len(use):
        truth, valid = _read(stack, use)
        lights = [stack.lights[i] for i in use]
        coder = encoding.parse(stack.encoding) if stack.encoding else None
        peak = float(np.percentile(truth, 99.9)) or 1.0
        predictions = {}
        for path in args.materials:
            start = time.process_time()
            material = read_material(path)
            if material.channels["label"].shape != truth.shape[1:3]:
                raise InputError(f"{path}: its size is not that of {args.stack}; fit it again")
            predicted = np.zeros_like(truth)
            for box in stack.tiles():
                predicted[:, box[0] : box[1], box[2] : box[3]] = prediction.predict(material, stack, box, use)
            seconds = time.process_time() - start
            predictions[path.stem] = predicted
            errors = _errors(predicted, truth, valid, lights, labels, regions, coder, peak)
            result["methods"][path.stem] = {**errors, "relight_cpu_seconds": round(seconds, 3)}
            print(
                f"{path.stem}: {errors['psnr']:.2f} dB, relative {errors['relative_error']:.3f}",
                file=sys.stderr,
            )
        picture = _picture(predictions, truth, lights, stack, peak)
    else:
        empty = np.full((40, 360, 3), 250, np.uint8)
        picture = pictures.sheet([[("no light was held out: there is nothing to judge by", empty)]])
    for path in args.materials:
        result["methods"].setdefault(path.stem, {})["fit"] = read_json(path.with_suffix(".json"))
    pictures.write_png(args.picture, picture)
    write_json(args.out, result)


def _read(stack: Stack, use: NDArray[np.intp]) -> tuple[Images, Images]:
    """Held-out photographs (light, y, x, 3) and whether each sample can be judged by."""
    truth = np.zeros((len(use), stack.height, stack.width, 3), np.float32)
    valid = np.zeros_like(truth)
    bad = HOT | SHIFTED | (0 if stack.encoding else SATURATED)
    for y0, y1, x0, x1 in stack.tiles():
        radiance, flags = stack.read_tile(y0, y1, x0, x1, lights=use)
        ok = ((flags & bad) == 0) & np.isfinite(radiance)
        valid[:, y0:y1, x0:x1] = ok
        truth[:, y0:y1, x0:x1] = np.where(ok, radiance, 0)
    return truth, valid


def _errors(
    predicted: Images,
    truth: Images,
    valid: Images,
    lights: list[Light],
    labels: LabelMap,
    regions: list[Region],
    coder: encoding.Encoding | None,
    peak: float,
) -> dict[str, Any]:
    """Errors over everything, by region, by light and by texel."""
    n = len(lights)
    flat = [a.reshape(n, -1, 3) for a in (predicted, truth, valid)]
    p, g, v = flat
    dp, dg = metrics.to_display(p, coder, peak), metrics.to_display(g, coder, peak)
    sines = np.array([max(1 - light.direction[2] ** 2, 0.0) ** 0.5 for light in lights])
    weight = sines if all(light.grid for light in lights) else np.ones(n)

    def over(inside: NDArray[np.bool_] | slice) -> dict[str, float]:
        by_light = [metrics.psnr(dp[i][inside], dg[i][inside], v[i][inside]) for i in range(n)]
        relative = metrics.relative_error(p[:, inside], g[:, inside], v[:, inside], weight)
        return {
            "relative_error": round(relative, 5),
            "psnr": round(float(np.mean(by_light)), 3),
            "psnr_min": round(float(np.min(by_light)), 3),
        }

    w = weight[:, None, None] * v
    texel = np.sqrt((w * (p - g) ** 2).sum((0, 2)) / np.maximum((w * g**2).sum((0, 2)), 1e-12))
    by_region = {r.name: {**over(labels.reshape(-1) == r.label), "texels": r.texels} for r in regions}
    by_light = {
        light.name: {
            "psnr": round(metrics.psnr(dp[i], dg[i], v[i]), 3),
            "relative_error": round(metrics.relative_error(p[i : i + 1], g[i : i + 1], v[i : i + 1], np.ones(1)), 5),
        }
        for i, light in enumerate(lights)
    }
    return {
        **over(slice(None)),
        "texel_median": round(float(np.median(texel)), 5),
        "texel_p95": round(float(np.percentile(texel, 95)), 5),
        "texels_above_1": round(float((texel > 1).mean()), 6),
        "regions": by_region,
        "lights": by_light,
    }


def _picture(
    predictions: dict[str, Images], truth: Images, lights: list[Light], stack: Stack, peak: float
) -> pictures.Picture:
    """Rows of held-out lights: the photograph, then each prediction and its error."""
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    to_rec709 = TO_REC709 @ stack.to_acescg

    def shown(image: Images, exposure: float, size: int) -> pictures.Picture:
        light = np.asarray(image @ to_rec709.T, np.float32)
        return pictures.enlarge(pictures.photograph(light, exposure), size)

    energy = truth.mean((1, 2, 3))
    order = np.argsort(-energy)
    chosen = order[np.linspace(0, len(order) - 1, min(SHOWN, len(order))).astype(int)]
    rows = []
    for i in chosen:
        exposure = 1.0 if coder else pictures.auto_exposure(truth[i] @ to_rec709.T)
        size = max(160, min(240, truth.shape[2]))
        row = [(lights[i].name, shown(truth[i], exposure, size))]
        for name, predicted in predictions.items():
            row.append((name, shown(predicted[i], exposure, size)))
            error = metrics.to_display(predicted[i], coder, peak) - metrics.to_display(truth[i], coder, peak)
            heat = pictures.heat(np.abs(error).mean(-1), 0.25)
            row.append((f"{name}: error, to 0.25", pictures.enlarge(heat, size)))
        rows.append(row)
    return pictures.sheet(rows)
