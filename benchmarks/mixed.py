"""Error of texels that two threads share, under their region's prior alone and with the prior of both regions."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.apart import spread
from kinran.base.exr import read_exr
from kinran.base.files import InputError, write_json
from kinran.compare import errors, fitted_lobes
from kinran.compare.trial import Single, Trial, read
from kinran.data.fabric import Fabric
from kinran.data.labels import MIXED
from kinran.data.texel_directions import Under
from kinran.fit.few_lights import FEW_LIGHTS
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran.radiance.coarsen import coarse_labels
from kinran.virtual.weave import VirtualFabric

Array = NDArray[np.float64]

FACTORS = (1, 2)
"""Texels along the side of a block that is averaged to one texel: coarser texels are mixed more often."""
COUNTS = (100, 50, 30)
"""Numbers of lights, far apart, that are tried beside all lights of the fabric."""
PURITY = (0.0, 0.7, 0.9, 1.01)
"""Bounds of the classes of texels, by the share of the thread that fills most of a texel. Choices."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--results", type=Path, required=True, help="results of `kinran demo`, config as it is")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    fabric = Fabric(args.results)
    channels, share = read_exr(fabric.labels_path), shares(VirtualFabric())
    if share.shape[:2] != fabric.labels.shape:
        raise InputError(f"{args.results}: is not of the virtual fabric of config.yaml; run `kinran demo` as it comes")
    found: list[dict[str, Any]] = []
    for factor in FACTORS:
        known = coarse_labels(channels, factor)
        second = np.where(known["membership"] < MIXED, known["second"], known["labels"])
        whole = coarse(read(fabric), factor, known["labels"], second)
        purity = average(share, factor).max(-1).reshape(-1)
        for count in (len(whole.lights), *COUNTS):
            own, shared = measure(whole.under(np.sort(spread(whole.samples.under.directions, count))), purity)
            found.append({"factor": factor, "lights": count, "own": own, "shared": shared})
            said = ", ".join(f"{name} {value:.4f} -> {shared[name]:.4f}" for name, value in own.items())
            print(f"{factor} × {factor} texels, {count} lights: {said}", flush=True)
    write_json(args.out, found)


def measure(trial: Trial, purity: Array) -> list[dict[str, float]]:
    """Relative errors by class of purity (texel,), under the region's prior alone and with one that is shared."""
    wanted = Lobes("ggx", 1) if len(trial.lights) < FEW_LIGHTS else Lobes("gaussian", 2)
    result = []
    for samples in (trial.samples.unshared(), trial.samples):
        e, g = errors.squares(trial.measured(fitted_lobes.fit(samples, wanted)), trial)
        row = {"all": errors.ratio_of(e, g)}
        for low, high in pairwise(PURITY):
            inside = (purity >= low) & (purity < high)
            row[f"purity {low:g}-{min(high, 1):g}"] = errors.ratio_of(e[inside], g[inside])
        result.append(row)
    return result


def shares(fabric: VirtualFabric) -> Array:
    """Share (y, x, kind) of the thread that fills most of each texel; the kinds of the rest are unknown, and 0."""
    label, purity = fabric.labels()
    return np.eye(len(fabric.names))[label] * purity[..., None]


def average(values: NDArray[Any], factor: int) -> NDArray[Any]:
    """Means (y, x, …) of blocks of texels."""
    return np.asarray(_blocks(values, factor).mean((1, 3)))


def _blocks(values: NDArray[Any], factor: int) -> NDArray[Any]:
    """(row, y in block, column, x in block, …) of values (y, x, …)."""
    height, width = values.shape[0] // factor, values.shape[1] // factor
    return values[: height * factor, : width * factor].reshape(height, factor, width, factor, *values.shape[2:])


def coarse(trial: Trial, factor: int, labels: NDArray[np.intp], second: NDArray[np.intp]) -> Trial:
    """The trial as a wider lens would have taken it; a sample that one texel of a block lacks, all of it lack."""

    def of(values: NDArray[Any], of_block: Callable[..., Any] = np.mean) -> Single:
        blocks = of_block(_blocks(values.reshape(*trial.shape, *values.shape[1:]), factor), (1, 3))
        return np.ascontiguousarray(blocks.reshape(-1, *values.shape[1:]), np.float32)

    def seen(under: Under) -> Under:
        """Directions of each block's first texel, and the mean of its falloff."""
        first = _blocks(np.arange(trial.texels).reshape(trial.shape), factor)[:, 0, :, 0].ravel()
        falloff = None if under.falloff is None else of(under.falloff)
        return replace(under.of(first), falloff=falloff)

    fine = trial.samples
    under = seen(fine.under)
    bounds = None if fine.bounds is None else of(fine.bounds, np.max)
    T = under.square_on(of(fine.under.reaching(fine.T)))
    return replace(
        trial,
        samples=Samples(T, of(fine.W, np.min), under, labels.reshape(-1), second.reshape(-1), bounds),
        held=seen(trial.held),
        truth=of(trial.truth),
        valid=of(trial.valid, np.min) == 1,
        full=of(trial.full, np.max) == 1,
        shape=labels.shape,
    )
