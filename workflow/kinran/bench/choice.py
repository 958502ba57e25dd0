"""What a byte has to gain: the lobes that are chosen at several costs, and what they lose under lights held out."""

import argparse
import contextlib
import os
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran import metrics, segment
from kinran.bench import real_sets
from kinran.chart.trial import Trial, read, spread
from kinran.files import InputError, write_json
from kinran.fit import choice, simplest
from kinran.fit.candidates import CANDIDATES, Candidate, Sampled, fit
from kinran.labels import read_labels, read_second
from kinran.stack import Stack
from kinran_bsdf.material import read_material, write_material

Array = NDArray[np.float64]
Single = NDArray[np.float32]

COSTS = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Gains in dB that a lobe has to bring, from a third of the pipeline's to three times that."""
LOBE_BYTES = 16
"""Bytes of a lobe in a material: eight numbers in half precision."""
COUNTS = (100, 50, 30)
"""Numbers of lights, far apart, that the choice is tried under beside all of the fabric's."""
SETS = ("item3", "item11", "material1", "material7")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--results", type=Path, help="a fabric's results, such as those of `kinran demo`")
    parser.add_argument("--data", type=Path, help="folder of the real sets")
    parser.add_argument("--sets", nargs="+", default=SETS, help="which of them")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    found: list[dict[str, Any]] = []
    if args.results:
        whole = _trial(args.results / "radiance.zarr", args.results / "labels.exr")
        counts = (len(whole.lights), *COUNTS)
        for count in counts:
            found.append(_row(args.results.name, whole.under(spread(whole.lights, count))))
        found.append({"name": args.results.name, "file": file_bytes(args.results)})
        print(f"bytes of the file, a texel: {found[-1]['file']}")
    for name in args.sets if args.data else ():
        if name not in real_sets.sets():
            raise InputError(f"--sets {name}: is none of {', '.join(real_sets.sets())}")
        with tempfile.TemporaryDirectory() as folder:
            stack, labels = Path(folder) / "radiance.zarr", Path(folder) / "labels.exr"
            real_sets.sets()[name](args.data).write(stack)
            with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stderr(nowhere):
                segment.main(stack.parent)
            found.append(_row(name, _trial(stack, labels)))
    write_json(args.out, found)


def file_bytes(results: Path) -> dict[str, float]:
    """Bytes a texel of a two-lobe material's file: as it is, and without lobes that texels alone do not need."""
    stack, labels = Stack.open(results / "radiance.zarr"), read_labels(results / "labels.exr")
    second, material = read_second(results / "labels.exr"), read_material(results / "fit" / "slope.exr")
    sample = choice.sampled(stack, labels, second, int(labels.max()) + 1)
    error = choice.judge(sample, 1)[CANDIDATES[-1].name].error(np.bincount(labels.ravel()) / labels.size)
    needs = simplest.texel_map(stack, labels, second, sample, error, 1)
    kept = {
        name: np.where(needs >= int(name[4]), plane, 0).astype(np.float32) if name.startswith("lobe") else plane
        for name, plane in material.channels.items()
    }
    with tempfile.TemporaryDirectory() as folder:
        whole, part = Path(folder) / "whole.exr", Path(folder) / "part.exr"
        write_material(whole, material)
        write_material(part, replace(material, channels=kept))
        sizes = [path.stat().st_size / labels.size for path in (whole, part)]
    names = "all lobes", "lobes that are needed", "share of second lobes"
    return dict(zip(names, (*sizes, float((needs > 1).mean())), strict=True))


def _trial(stack: Path, labels: Path) -> Trial:
    return read(Stack.open(stack), read_labels(labels), np.eye(3), read_second(labels))


def _row(name: str, trial: Trial) -> dict[str, Any]:
    row = {"name": name, "lights": len(trial.lights), **measure(trial)}
    alone = ", ".join(f"{key} {value:.2f}" for key, value in row["alone"].items())
    print(f"{name}, {row['lights']} lights; dB of each alone: {alone}")
    for cost, at in row["costs"].items():
        kinds = ", ".join(f"{count} × {kind}" for kind, count in Counter(at["chosen"]).items())
        print(f"  {cost:>4s} dB a lobe: {kinds}; {at['bytes']:.1f} bytes, {at['lost']:.2f} dB lost", flush=True)
    return row


def measure(trial: Trial, threads: int = 1) -> dict[str, Any]:
    """PSNR of each candidate alone on the lights held out; at each cost what is chosen, its bytes and dB lost.

    What is lost is against the best of all of these.
    """
    present, region = np.unique(trial.region, return_inverse=True)
    second = np.where(np.isin(trial.second, present), np.searchsorted(present, trial.second), region)
    whole = Sampled(
        trial.T, trial.W, trial.lights, region, second, lambda T: metrics.to_display(T, trial.coder, trial.peak)
    )
    inside = [np.flatnonzero(region == k) for k in range(len(present))]
    some = [at[np.linspace(0, len(at) - 1, min(choice.SAMPLE, len(at))).astype(int)] for at in inside]
    sample = whole.of(np.concatenate(some))
    share = np.array([len(at) for at in inside]) / len(region)
    judged = choice.judge(sample, threads)
    said = {c.name: fit(c, whole, trial.held_out, sample.priors(c, threads), threads) for c in CANDIDATES}
    alone = {name: _psnr(T, trial) for name, T in said.items()}
    costs: dict[str, dict[str, Any]] = {}
    for cost in COSTS:
        kinds = choice.choose(judged, share, cost / LOBE_BYTES)[1]
        costs[f"{cost:g}"] = {
            "chosen": [kind.name for kind in kinds],
            "bytes": float(share @ [kind.size for kind in kinds]),
            "psnr": _psnr(_joined(said, kinds, region), trial),
        }
    best = max([*alone.values(), *(at["psnr"] for at in costs.values())])
    for at in costs.values():
        at["lost"] = best - at["psnr"]
    return {"alone": alone, "costs": costs}


def _joined(said: dict[str, Single], kinds: list[Candidate], region: NDArray[np.intp]) -> Single:
    """Each region as its candidate says."""
    names = np.array([kind.name for kind in kinds])[region]
    result = np.empty_like(next(iter(said.values())))
    for name in set(names.tolist()):
        result[names == name] = said[name][names == name]
    return result


def _psnr(predicted: Single, trial: Trial) -> float:
    """Mean over the lights held out, in dB, of displayed values."""
    p, g, v = (np.moveaxis(a, -1, 0) for a in (predicted, trial.truth, trial.valid.astype(np.float32)))
    shown = [metrics.to_display(a, trial.coder, trial.peak) for a in (p, g)]
    return float(np.mean([metrics.psnr(*pair) for pair in zip(*shown, v, strict=True)]))
