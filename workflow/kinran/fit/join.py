"""Join the fitted runs of a model to its material file."""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kinran.files import InputError, sha256, write_json
from kinran.fit.chosen import add_lobes
from kinran.fit.fitted import fitted_labels
from kinran.fit.tile import MODELS
from kinran.labels import LabelMap, read_labels, read_regions
from kinran.stack import Stack
from kinran_bsdf.material import Material, write_material
from kinran_bsdf.models import clamp

Map = NDArray[np.float32]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--model", choices=MODELS, required=True)
    add_lobes(parser)
    parser.add_argument("--fitted", type=int, nargs="*", help="labels that have a lobe (default: all)")
    parser.add_argument("--need", type=Path, help="instead of --fitted: what a scene needs (.json)")
    parser.add_argument("--runs", type=Path, nargs="+", required=True, help="fitted runs (.npz)")
    parser.add_argument("--summary", type=Path, required=True, help="cost and clamping of the fit (.json)")
    parser.add_argument("out", type=Path, help="material (.exr)")


def main(args: argparse.Namespace) -> None:
    """Write the material and a summary of what it cost."""
    stack = Stack.open(args.stack)
    labels = read_labels(args.labels)
    args.fitted = fitted_labels(args, labels)
    maps: dict[str, Map] = {}
    covered = np.zeros(labels.shape, bool)
    totals = {"cpu_seconds": 0.0, "read_seconds": 0.0}
    peak = 0.0
    for run in args.runs:
        with np.load(run) as data:
            _scatter(data, maps, covered)
            for key in totals:
                totals[key] += float(data[key])
            peak = max(peak, float(data["peak_mb"]))
    if not covered.all():
        raise InputError(f"{args.out}: {int((~covered).sum())} texels have no fit; give all runs of the model")
    filled = _fill(maps, maps.pop("fit.valid") > 0, labels)
    channels = _material_channels(maps, stack.to_acescg)
    channels["label"] = labels.astype(np.float32)
    model = args.model
    material = Material(
        channels=channels,
        model=model,
        tail=args.tail if model == "slope" else "ggx",
        lobes={"lambert": 0, "slope": args.lobes}.get(model, 1),
        regions=[
            {
                "label": r.label,
                "name": r.name,
                "model": model if args.fitted is None or r.label in args.fitted else "lambert",
            }
            for r in read_regions(args.regions)
        ],
        colour="lin_ap1_scene",
        from_stack=stack.to_acescg,
        texel_mm=stack.texel_mm,
        source=sha256(args.stack / "zarr.json"),
        theta_max=float(np.arccos(min(light.direction[2] for light in stack.lights if not light.held_out))),
        encoding=stack.encoding or "",
        crop=stack.crop,
    )
    bound = clamp(material)
    write_material(args.out, replace(material, channels={**channels, "bound": bound}))
    write_json(
        args.summary,
        {
            "model": model,
            "texels": labels.size,
            "lights": sum(not light.held_out for light in stack.lights),
            **{key: round(value, 3) for key, value in totals.items()},
            "microseconds_per_texel": round(1e6 * totals["cpu_seconds"] / labels.size, 2),
            "peak_mb": round(peak),
            "bytes_per_texel": 2 * (len(maps) + 1),
            "filled_texels": filled,
            "clamped_share": round(float((bound < 1).mean()), 5),
        },
    )


def _scatter(data: "np.lib.npyio.NpzFile", maps: dict[str, Map], covered: NDArray[np.bool_]) -> None:
    names = [name for name in data.files if "." in name]
    start = 0
    for y0, y1, x0, x1 in data["boxes"]:
        stop = start + (y1 - y0) * (x1 - x0)
        for name in names:
            plane = maps.setdefault(name, np.zeros(covered.shape, np.float32))
            plane[y0:y1, x0:x1] = data[name][start:stop].reshape(y1 - y0, x1 - x0)
        covered[y0:y1, x0:x1] = True
        start = stop


def _fill(maps: dict[str, Map], valid: NDArray[np.bool_], labels: LabelMap) -> int:
    """Give texels without a fit of their own that of the nearest one of their region; returns their number."""
    for label in np.unique(labels[~valid]):
        donors = valid & (labels == label)
        if not donors.any():
            donors = valid
        if not donors.any():
            return 0
        _, (y, x) = distance_transform_edt(~donors, return_indices=True)
        hole = ~valid & (labels == label)
        for plane in maps.values():
            plane[hole] = plane[y[hole], x[hole]]
    return int((~valid).sum())


def _material_channels(maps: dict[str, Map], to_acescg: NDArray[np.float64]) -> dict[str, Map]:
    """Colours to ACEScg in [0, 1] times an amplitude in 1/sr; no albedo bound yet."""
    channels = {name: plane for name, plane in maps.items() if name.split(".")[1] not in "RGB"}
    for part in sorted({name.split(".")[0] for name in maps}):
        stack_rgb = np.stack([maps[f"{part}.{c}"] for c in "RGB"], -1).astype(float) / np.pi
        rgb = stack_rgb @ to_acescg.T
        amplitude = np.maximum(rgb.max(-1), 0)
        colour = rgb / np.where(amplitude > 0, amplitude, 1)[..., None]
        channels[f"{part}.amplitude"] = amplitude.astype(np.float32)
        for i, c in enumerate("RGB"):
            channels[f"{part}.{c}"] = colour[..., i].astype(np.float32)
    channels["bound"] = np.ones_like(channels["diffuse.amplitude"])
    return channels
