"""Join the fitted runs of a model into its material file."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, sha256, write_json
from kinran.base.npz import read_npz
from kinran.data.fabric import Fabric
from kinran.data.fit_runs import write_runs
from kinran.data.labels import LabelMap
from kinran.fit.lobed_regions import chosen_lobes, kind, lobed_labels
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.material import Material, write_material
from kinran_bsdf.models import MODELS, Lambert, Slope
from kinran_bsdf.relight import clamp

log = logging.getLogger(__name__)

Map = NDArray[np.float32]

NOT_MEASURED = -1
"""Label of texels outside the mask of a set, whose other channels are 0."""
COSTS = ("cpu_seconds", "read_seconds")


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    runs: Annotated[tuple[Path, ...], "fitted runs (.npz)"]
    need: Annotated[Path | None, "needs of a scene (.json), instead of --fitted"] = None
    choice: Annotated[Path | None, "lobes that `kinran choice` chose (.json), instead of --lobes and --tail"] = None


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    material: Annotated[Path, "OUT", "material (.exr)"]
    summary: Annotated[Path, "cost and clamping of the fit (.json)"]


@dataclass(frozen=True)
class Options:
    """Options that the runs were fitted with."""

    model: Annotated[str, "model of the material"] = Slope.name
    lobes: Annotated[Literal[1, 2], "number of lobes of the slope model"] = 1
    tail: Annotated[Literal["gaussian", "ggx"], "tail of its lobes"] = "ggx"
    fitted: Annotated[tuple[int, ...] | None, "labels that have a lobe (default: all)"] = None
    settings: Annotated[str, "what the runs were planned with, in a word: it is noted with their number"] = ""


def main(inputs: Inputs, out: Outputs, options: Options = Options()) -> None:
    """Write the material, a summary of its cost, and beside it how many runs it was fitted in.

    Raises
    ------
    InputError
        A run is missing, damaged or of another kind, or the model is unknown.
    """
    fabric = Fabric(inputs.fabric)
    labels = fabric.labels
    lobes = chosen_lobes(inputs.choice, options.tail, options.lobes)
    maps, costs, peak = _maps(inputs.runs, kind(options.model, lobes), out.material, labels.shape)
    inside = fabric.stack.inside
    widened = (maps.pop("fit.widened", np.zeros(1)) > 0) & inside
    filled = _fill(maps, (maps.pop("fit.valid") > 0) | ~inside, labels)
    for plane in maps.values():
        plane[~inside] = 0
    material = _material(fabric, inputs, options, lobes, maps)
    bound = clamp(material)
    write_material(out.material, replace(material, channels={**material.channels, "bound": bound}))
    summary: dict[str, Any] = {
        "model": options.model,
        "texels": labels.size,
        "lights": int((~fabric.stack.held_out).sum()),
        **{key: round(value, 3) for key, value in costs.items()},
        "microseconds_per_texel": round(1e6 * costs["cpu_seconds"] / labels.size, 2),
        "peak_mb": round(peak),
        "bytes_per_texel": 2 * (len(maps) + 1),
        "filled_texels": filled,
        "widened_texels": int(widened.sum()),
        "outside_texels": int((~inside).sum()),
        "clamped_share": round(float((bound < 1)[inside].mean()), 5),
    }
    write_runs(out.material, len(inputs.runs), options.settings)
    write_json(out.summary, summary)
    if widened.any():
        log.info("material: %d texels had a needle between lights; it is as wide as their gap now", widened.sum())
    if filled:
        log.info("material: %d texels have no samples of their own; filled from their regions", filled)


def _material(fabric: Fabric, inputs: Inputs, options: Options, lobes: Lobes, maps: dict[str, Map]) -> Material:
    """The material of all maps, without its albedo bound."""
    stack, model = fabric.stack, options.model
    if model not in MODELS:
        raise InputError(f"model {model}: is none of {', '.join(MODELS)}")
    lobed = lobed_labels(fabric.labels, options.fitted, inputs.need, inputs.choice)
    channels = _material_channels(maps, stack.to_acescg)
    channels["label"] = np.where(stack.inside, fabric.labels, np.float32(NOT_MEASURED))
    models = [model if lobed is None or r.label in lobed else Lambert.name for r in fabric.regions]
    return Material(
        channels=channels,
        model=model,
        tail=lobes.tail,
        lobes=MODELS[model].of(lobes.tail, lobes.count).lobes,
        regions=[{"label": r.label, "name": r.name, "model": of} for r, of in zip(fabric.regions, models, strict=True)],
        colour="lin_ap1_scene",
        from_stack=stack.to_acescg,
        texel_mm=stack.texel_mm,
        source=sha256(stack.path / "zarr.json"),
        theta_max=float(np.arccos(min(light.direction[2] for light in stack.lights if not light.held_out))),
        encoding=stack.encoding or "",
        crop=stack.crop,
    )


def _maps(
    runs: Sequence[Path], of: str, out: Path, shape: tuple[int, ...]
) -> tuple[dict[str, Map], dict[str, float], float]:
    """Maps (y, x) of all runs of a kind, the sums of their costs, and the largest peak of memory in MiB."""
    maps: dict[str, Map] = {}
    covered = np.zeros(shape, bool)
    costs, peak = dict.fromkeys(COSTS, 0.0), 0.0
    for run in runs:
        data = read_npz(run, "fitted run", "make it with kinran fit")
        if "kind" not in data:
            raise InputError(f"{run}: is no fitted run; make it with kinran fit")
        if str(data["kind"]) != of:
            raise InputError(
                f"{run}: was fitted as {data['kind']}, not as {of}; give the options that it was fitted with"
            )
        _scatter(data, maps, covered)
        costs = {key: value + float(data[key]) for key, value in costs.items()}
        peak = max(peak, float(data["peak_mb"]))
    if not covered.all():
        raise InputError(f"{out}: {int((~covered).sum())} texels have no fit; give all runs of the model")
    return maps, costs, peak


def _scatter(data: dict[str, NDArray[Any]], maps: dict[str, Map], covered: NDArray[np.bool_]) -> None:
    names = [name for name in data if "." in name]
    start = 0
    for y0, y1, x0, x1 in data["boxes"]:
        stop = start + (y1 - y0) * (x1 - x0)
        for name in names:
            plane = maps.setdefault(name, np.zeros(covered.shape, np.float32))
            plane[y0:y1, x0:x1] = data[name][start:stop].reshape(y1 - y0, x1 - x0)
        covered[y0:y1, x0:x1] = True
        start = stop


def _fill(maps: dict[str, Map], valid: NDArray[np.bool_], labels: LabelMap) -> int:
    """Give texels without a fit that of the nearest texel of their region, and return their number."""
    from scipy.ndimage import distance_transform_edt

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
    """Channels (y, x) of the material: colours in ACEScg in [0, 1] times an amplitude in 1/sr; the bound is 1."""
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
