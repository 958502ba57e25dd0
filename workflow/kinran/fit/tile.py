"""Fit a model to a run of tiles of the radiance stack."""

import argparse
import resource
import sys
import time
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.files import InputError, atomic
from kinran.fit import lambert, samples, slope, takeda
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, squared_widths
from kinran.labels import read_labels
from kinran.needed import needed_labels
from kinran.stack import Stack

LEAST_SAMPLES = 4
"""Texels with fewer usable samples, such as those on a defect of the sensor, have no fit of their own."""
MODELS = ("takeda2008", "slope", "lambert")
SHAPES = {
    "takeda2008": ("theta", "phi", "dt", "dp"),
    "slope": ("x", "y", "xx", "xy", "yy"),
    "lambert": (),
}
"""Names of the lobe's shape channels."""

Channels = dict[str, NDArray[np.float64]]


def add_lobes(parser: argparse.ArgumentParser) -> None:
    """Arguments that say what lobes the slope model has."""
    parser.add_argument("--lobes", type=int, choices=(1, 2), default=1, help="lobes of the slope model")
    parser.add_argument("--tail", choices=tuple(TAILS), default="ggx", help="tail of the slope model's lobes")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--model", choices=MODELS, required=True)
    add_lobes(parser)
    parser.add_argument("--prior", type=Path, help="priors of the regions (.json), for slope")
    parser.add_argument(
        "--fitted", type=int, nargs="*", help="labels that get a lobe (default: all); the rest stay a texture"
    )
    parser.add_argument("--need", type=Path, help="instead of --fitted: what a scene needs (.json)")
    parser.add_argument("--tile", default="0/1", help="which run of tiles: INDEX/COUNT, from 0")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="parameters of the run's texels (.npz)")


def main(args: argparse.Namespace) -> None:
    """Fit the run and write its parameters, with the CPU seconds that they took."""
    stack = Stack.open(args.stack)
    labels = read_labels(args.labels)
    if args.need:
        args.fitted = needed_labels(args.need, labels)
    priors = None
    if args.prior:
        priors = slope.read_priors(args.prior)
        if any(prior.lobes != args.lobes for prior in priors):
            raise InputError(f"{args.prior}: is of another number of lobes than {args.lobes}; make it again")
    boxes = samples.share(stack.tiles(), args.tile)
    done, total = 0, sum((y1 - y0) * (x1 - x0) for y0, y1, x0, x1 in boxes)
    parts: list[Channels] = []
    _warm_up(args)
    start, reading = time.process_time(), 0.0
    for box in boxes:
        before = time.process_time()
        tile = samples.read(stack, box)
        reading += time.process_time() - before
        region = samples.cut(labels, box)
        parts.append(_fit(args, stack, tile, region, priors))
        parts[-1]["fit.valid"] = ((tile.W > 0).sum(1) >= LEAST_SAMPLES).astype(float)
        done += len(region)
        print(f"{args.model}: {done} of {total} texels", file=sys.stderr, flush=True)
    seconds = time.process_time() - start - reading
    names = list(parts[0]) if parts else []
    arrays = {name: np.concatenate([part[name] for part in parts]).astype(np.float32) for name in names}
    with atomic(args.out) as temporary, temporary.open("wb") as file:
        costs = {
            "boxes": np.array(boxes, np.int64).reshape(-1, 4),
            "cpu_seconds": np.array(seconds),
            "read_seconds": np.array(reading),
            "peak_mb": np.array(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        }
        np.savez(file, allow_pickle=False, **costs, **arrays)


def _fit(
    args: argparse.Namespace,
    stack: Stack,
    tile: samples.Samples,
    region: NDArray[np.intp],
    priors: list[slope.Prior] | None,
) -> Channels:
    """Channels (texel,) of one tile, colours in the stack's unit and space."""
    model = args.model
    lights = samples.training_directions(stack)
    if model == "lambert":
        return _channels((), np.zeros((len(region), 0)), lambert.fit(tile.T, tile.W, lights)[:, None])
    if model == "slope":
        result = slope.fit(tile.T, tile.W, lights, args.tail, args.lobes, priors, region, args.threads)
        lobes = [result.shapes[:, LOBE_SIZE * k : LOBE_SIZE * (k + 1)] for k in range(args.lobes)]
        shapes = [np.stack([p[:, 0], p[:, 1], *squared_widths(p)], 1) for p in lobes]
        channels = _channels(SHAPES[model], np.concatenate(shapes, 1), result.colours)
        channels["diffuse.x"], channels["diffuse.y"] = result.shapes[:, -DIFFUSE_SIZE:].T
    else:
        steps = takeda.four_steps(tile.T, lights, *_tolerances(stack))
        channels = _channels(SHAPES[model], steps.shapes, steps.colours)
    if args.fitted is not None:
        _leave_as_texture(channels, ~np.isin(region, args.fitted), lambert.fit(tile.T, tile.W, lights))
    return channels


def _channels(names: tuple[str, ...], shapes: NDArray[np.float64], colours: NDArray[np.float64]) -> Channels:
    """Name the shapes (texel, lobes × K) and the colours (texel, lobes + 1, 3)."""
    lobes = [f"lobe{k + 1}" for k in range(colours.shape[1] - 1)]
    channels = {f"{lobe}.{name}": shapes[:, k] for k, (lobe, name) in enumerate(product(lobes, names))}
    for k, part in enumerate([*lobes, "diffuse"]):
        channels.update({f"{part}.{c}": colours[:, k, i] for i, c in enumerate("RGB")})
    channels["diffuse.x"] = channels["diffuse.y"] = np.zeros(len(colours))
    return channels


def _leave_as_texture(channels: Channels, plain: NDArray[np.bool_], colour: NDArray[np.float64]) -> None:
    """Give the texels that are not fitted no lobe and their Lambertian colour (Takeda2008, §4)."""
    for i, c in enumerate("RGB"):
        for lobe in {name.split(".")[0] for name in channels if name.startswith("lobe")}:
            channels[f"{lobe}.{c}"] = np.where(plain, 0, channels[f"{lobe}.{c}"])
        channels[f"diffuse.{c}"] = np.where(plain, colour[:, i], channels[f"diffuse.{c}"])
    for name in ("diffuse.x", "diffuse.y"):
        channels[name] = np.where(plain, 0, channels[name])


def _tolerances(stack: Stack) -> tuple[float, float]:
    """Half a step of the grid in θ_i and φ_i; 5° and 15° for scattered lights. Radians."""
    grid = np.array([light.grid for light in stack.lights if light.grid])
    if len(grid) < len(stack.lights):
        return float(np.radians(5)), float(np.radians(15))
    thetas = np.unique([round(float(np.degrees(np.arccos(light.direction[2]))), 3) for light in stack.lights])
    azimuths = grid[:, 1].max() + 1
    return float(np.radians(0.5 * np.median(np.diff(thetas)))), float(1.02 * np.pi / azimuths)


def _warm_up(args: argparse.Namespace) -> None:
    """Compile before the clock starts."""
    if args.model == "slope":
        lights = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 0.75**0.5], [0.0, 0.5, 0.75**0.5]])
        slope.fit(np.ones((1, 3, 3), np.float32), np.ones((1, 3), np.float32), lights, args.tail, args.lobes)
    samples.texels_first(np.ones((1, 1, 1, 3), np.float32), np.zeros((1, 1, 1, 3), np.uint8), np.ones(256, np.float32))
