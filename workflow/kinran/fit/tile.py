"""Fit a model to a run of tiles of the radiance stack."""

import argparse
import resource
import sys
import time
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import near
from kinran.code import digest
from kinran.files import InputError, atomic
from kinran.fit import bounded, lambert, progress, reweighted, samples, slope, takeda, trust
from kinran.fit.chosen import add_lobes
from kinran.fit.fitted import fitted_labels
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, squared_widths
from kinran.labels import read_labels, read_second
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

KIND = ("lobes", "priors", "region", "threads")
"""What `kinran.fit.slope.fit` takes after the tail."""

Channels = dict[str, NDArray[np.float64]]


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
    """Fit the run and write its parameters, with the CPU seconds that they took.

    Each tile is kept when it is done: a run that was stopped goes on where it was.
    """
    stack = Stack.open(args.stack)
    labels, second = read_labels(args.labels), read_second(args.labels)
    args.fitted = fitted_labels(args, labels)
    priors, trusted = None, None
    if args.prior:
        trusted = trust.read(args.prior, [stack.lights[i] for i in samples.training_lights(stack)])
        priors = slope.read_priors(args.prior)
        if any(prior.lobes != args.lobes for prior in priors):
            raise InputError(f"{args.prior}: is of another number of lobes than {args.lobes}; make it again")
    boxes = samples.share(stack.tiles(), args.tile)
    finished = progress.Finished.of(args.out, _key(args))
    done, total = 0, sum((y1 - y0) * (x1 - x0) for y0, y1, x0, x1 in boxes)
    _warm_up(args)
    for box in boxes:
        region = samples.cut(labels, box)
        if not finished.has(box):
            start = time.process_time()
            tile = samples.read(stack, box)
            tile = tile.weighed(trusted.lights) if trusted and (trusted.lights < 1).any() else tile
            reading = time.process_time() - start
            part = _fit(args, stack, tile, region, samples.cut(second, box), priors, bool(trusted and trusted.outliers))
            part["fit.valid"] = ((tile.W > 0).sum(1) >= LEAST_SAMPLES).astype(float)
            fitting = time.process_time() - start - reading
            costs = {"cpu_seconds": np.array(fitting), "read_seconds": np.array(reading)}
            finished.keep(box, {**costs, **{name: values.astype(np.float32) for name, values in part.items()}})
        done += len(region)
        print(f"{args.model}: {done} of {total} texels", file=sys.stderr, flush=True)
    parts = [finished.read(box) for box in boxes]
    names = list(parts[0]) if parts else ["cpu_seconds", "read_seconds"]
    costs = {name: np.sum([part[name] for part in parts]) for name in names if "." not in name}
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in names if "." in name}
    with atomic(args.out) as temporary, temporary.open("wb") as file:
        costs |= {
            "boxes": np.array(boxes, np.int64).reshape(-1, 4),
            "peak_mb": np.array(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
        }
        np.savez(file, allow_pickle=False, **costs, **arrays)
    finished.clear()


def _key(args: argparse.Namespace) -> str:
    """What the result of a tile depends on."""
    options = [str(value) for value in (args.model, args.lobes, args.tail, args.fitted)]
    files = [path for path in (args.labels, args.prior) if path]
    return progress.key([digest("kinran.fit.tile"), *options], files, args.stack)


def _fit(
    args: argparse.Namespace,
    stack: Stack,
    tile: samples.Samples,
    region: NDArray[np.intp],
    second: NDArray[np.intp],
    priors: list[slope.Prior] | None,
    outliers: bool,
) -> Channels:
    """Channels (texel,) of one tile, colours in the stack's unit and space; 0 where a texel has no such part."""
    lobed = np.full(len(region), True) if args.fitted is None else np.isin(region, args.fitted)
    lobes = {"lambert": 0, "slope": args.lobes}.get(args.model, 1)
    channels = _channels(
        SHAPES[args.model],
        np.zeros((len(region), lobes * len(SHAPES[args.model]))),
        np.zeros((len(region), lobes + 1, 3)),
    )
    for cell in near.cells(stack, tile.box, samples.training_lights(stack)):
        factor = np.ones((len(cell.at), 1), np.float32) if cell.factor is None else cell.factor
        for model, chosen in ((args.model, lobed[cell.at]), ("lambert", ~lobed[cell.at])):
            at = cell.at[chosen]
            if not len(at):
                continue
            whole = len(at) == len(region) and cell.factor is None
            part = tile if whole else tile.part(at, factor[chosen])
            for name, values in _fit_cell(
                args, model, stack, part, cell, region[at], second[at], priors, outliers
            ).items():
                channels[name][at] = values
    return channels


def _fit_cell(
    args: argparse.Namespace,
    model: str,
    stack: Stack,
    tile: samples.Samples,
    cell: near.Cell,
    region: NDArray[np.intp],
    second: NDArray[np.intp],
    priors: list[slope.Prior] | None,
    outliers: bool,
) -> Channels:
    """Channels (texel,) of texels under the same directions."""
    T, W = tile.T, tile.W
    if model == "lambert":
        return _channels((), np.zeros((len(region), 0)), lambert.fit(T, W, cell.lights)[:, None])
    if model == "takeda2008":
        steps = takeda.four_steps(T, cell.lights, *_tolerances(stack))
        return _channels(SHAPES[model], steps.shapes, steps.colours)
    kind = args.tail, args.lobes, priors, region, args.threads
    if outliers:
        fit = partial(slope.fit, **dict(zip(KIND, kind[1:], strict=True)), slopes=cell.slopes, second=second)
        result, W = reweighted.robust(T, W, cell.lights, args.tail, fit, cell.slopes)
    else:
        result = slope.fit(T, W, cell.lights, *kind, slopes=cell.slopes, second=second)
    if tile.bounds is not None:
        result = bounded.refit(result, T, W, tile.bounds, cell.lights, *kind, cell.slopes, second)
    lobes = [result.shapes[:, LOBE_SIZE * k : LOBE_SIZE * (k + 1)] for k in range(args.lobes)]
    shapes = [np.stack([p[:, 0], p[:, 1], *squared_widths(p)], 1) for p in lobes]
    channels = _channels(SHAPES[model], np.concatenate(shapes, 1), result.colours)
    channels["diffuse.x"], channels["diffuse.y"] = result.shapes[:, -DIFFUSE_SIZE:].T
    return channels


def _channels(names: tuple[str, ...], shapes: NDArray[np.float64], colours: NDArray[np.float64]) -> Channels:
    """Name the shapes (texel, lobes × K) and the colours (texel, lobes + 1, 3)."""
    lobes = [f"lobe{k + 1}" for k in range(colours.shape[1] - 1)]
    channels = {f"{lobe}.{name}": shapes[:, k] for k, (lobe, name) in enumerate(product(lobes, names))}
    for k, part in enumerate([*lobes, "diffuse"]):
        channels.update({f"{part}.{c}": colours[:, k, i] for i, c in enumerate("RGB")})
    channels["diffuse.x"], channels["diffuse.y"] = np.zeros((2, len(colours)))
    return channels


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
