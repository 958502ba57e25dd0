"""The lobes that `kinran choice` takes at several costs of a byte, and their loss under lights held out."""

import argparse
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import real_sets, stages
from kinran.base.apart import spread
from kinran.base.files import InputError, write_json
from kinran.compare import errors, fitted_lobes
from kinran.compare.trial import Trial, read
from kinran.data import metrics
from kinran.data.fabric import Fabric
from kinran.fit import choice, texel_map
from kinran.fit.candidates import CANDIDATES, Candidate, display
from kinran.fit.samples import read_some, spread_over_regions
from kinran_bsdf.material import read_material, write_material

Single = NDArray[np.float32]

COSTS = (0.1, 0.2, 0.3, 0.5, 1.0)
"""Gains in dB that a lobe has to bring, from a third of the pipeline's to three times that (`candidates.DB_A_BYTE`)."""
LOBE_BYTES = 16
"""Bytes of a lobe in a material: eight numbers in half precision."""
COUNTS = (100, 50, 30)
"""Numbers of lights, far apart, that are tried beside all lights of the fabric."""
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
        whole = read(Fabric(args.results))
        for count in (len(whole.lights), *COUNTS):
            few = np.sort(spread(whole.samples.under.directions, count))
            found.append(_row(args.results.name, whole.under(few)))
        found.append({"name": args.results.name, "file": file_bytes(args.results)})
        print(f"bytes of the file, a texel: {found[-1]['file']}")
    for name in args.sets if args.data else ():
        if name not in real_sets.sets():
            raise InputError(f"--sets {name}: is none of {', '.join(real_sets.sets())}")
        with tempfile.TemporaryDirectory() as folder:
            real_sets.sets()[name](args.data).write(Path(folder) / "radiance.zarr")
            with stages.quiet():
                fabric = stages.segmented(Path(folder))
            found.append(_row(name, read(fabric)))
    write_json(args.out, found)


def file_bytes(results: Path) -> dict[str, float]:
    """Bytes per texel of a two-lobe material's file, with all lobes and without those that texels do not need."""
    fabric, material = Fabric(results), read_material(results / "fit" / "slope.exr")
    labels = fabric.labels
    sample = read_some(fabric, spread_over_regions(labels, len(fabric.regions), choice.SAMPLE))
    shown = display(fabric.stack, sample.T)
    error = choice.judge(sample, shown, 1)[CANDIDATES[-1].name].error(np.bincount(labels.ravel()) / labels.size)
    needs = texel_map.texel_map(fabric, sample, shown, error, 1)
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


def _row(name: str, trial: Trial) -> dict[str, Any]:
    row = {"name": name, "lights": len(trial.lights), **measure(trial)}
    alone = ", ".join(f"{key} {value:.2f}" for key, value in row["alone"].items())
    print(f"{name}, {row['lights']} lights; dB of each alone: {alone}")
    for cost, at in row["costs"].items():
        kinds = ", ".join(f"{count} × {kind}" for kind, count in Counter(at["chosen"]).items())
        print(f"  {cost:>4s} dB a lobe: {kinds}; {at['bytes']:.1f} bytes, {at['lost']:.2f} dB lost", flush=True)
    return row


def measure(trial: Trial, threads: int = 1) -> dict[str, Any]:
    """PSNR of each candidate alone on the lights held out, and at each cost the choice, its bytes and its loss in dB.

    The loss is that against the best of all of these.
    """
    samples = fitted_lobes.of_present_regions(trial.samples)
    sizes = np.bincount(samples.region)
    some = spread_over_regions(samples.region, len(sizes), choice.SAMPLE)
    sample, share = samples.of(np.flatnonzero(some)), sizes / len(samples)

    def shown(light: Single) -> Single:
        return metrics.to_display(light, trial.coder, trial.peak)

    def said_by(candidate: Candidate) -> Single:
        priors = candidate.priors(sample, threads)
        return trial.held.reaching(candidate.predicted(samples, priors, trial.held, threads))

    judged = choice.judge(sample, shown, threads)
    said = {candidate.name: said_by(candidate) for candidate in CANDIDATES}
    alone = {name: _psnr(T, trial) for name, T in said.items()}
    costs: dict[str, dict[str, Any]] = {}
    for cost in COSTS:
        kinds = choice.choose(judged, share, cost / LOBE_BYTES)[1]
        costs[f"{cost:g}"] = {
            "chosen": [kind.name for kind in kinds],
            "bytes": float(share @ [kind.size for kind in kinds]),
            "psnr": _psnr(_joined(said, kinds, samples.region), trial),
        }
    best = max([*alone.values(), *(at["psnr"] for at in costs.values())])
    for at in costs.values():
        at["lost"] = best - at["psnr"]
    return {"alone": alone, "costs": costs}


def _joined(said: dict[str, Single], kinds: list[Candidate], region: NDArray[np.intp]) -> Single:
    """Join predictions (texel, 3, light): each region has that of its candidate."""
    names = np.array([kind.name for kind in kinds])[region]
    result = np.empty_like(next(iter(said.values())))
    for name in set(names.tolist()):
        result[names == name] = said[name][names == name]
    return result


def _psnr(predicted: Single, trial: Trial) -> float:
    """Mean PSNR, in dB, of displayed values over the lights held out."""
    return float(errors.psnr(predicted, trial).mean())
