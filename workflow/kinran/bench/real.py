"""Accuracy on real sets: the pipeline's material on lights that it has not seen, beside interpolation and harmonics."""

import argparse
import contextlib
import platform
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from kinran import __main__ as kinran
from kinran import metrics
from kinran.baselines import basis, components, interpolation
from kinran.bench import real_nbrdf, real_sets
from kinran.chart.trial import Trial
from kinran.chart.trial import read as read_trial
from kinran.code import ROOT
from kinran.config import FEW_LIGHTS
from kinran.files import InputError, read_json, write_json
from kinran.fit import normals
from kinran.labels import read_labels
from kinran.stack import Stack
from kinran_bsdf.material import read_material
from kinran_bsdf.relight import relight

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

PLATE = interpolation.thin_plate(1e-3)
PEERS: dict[str, tuple[int, Callable[[Samples, Array], Any], Callable[[Any, Array], Samples]]] = {
    "PTM": (3, lambda T, lights: basis.fit(T, lights, basis.polynomial), basis.predict),
    "HSH16": (3, lambda T, lights: basis.fit(T, lights, basis.harmonics(16), 1e-6), basis.predict),
    "PCA9": (1, lambda T, lights: components.fit(T, lights, 9, PLATE), components.predict),
    "Delaunay": (3, lambda T, lights: interpolation.fit(T, lights, interpolation.linear), interpolation.predict),
    "thin plate": (3, lambda T, lights: interpolation.fit(T, lights, PLATE), interpolation.predict),
}
"""Channels that share their numbers, and the fit and the prediction. PCA has components of each channel of a texel."""
COMPARED = ("PTM", "HSH16", "PCA9")
"""Peers of some ten numbers a texel, like the material; the others keep all samples."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the real sets")
    parser.add_argument("--sets", nargs="+", help="which (default: all): " + ", ".join([*real_sets.sets(), "nbrdf"]))
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    known = real_sets.sets()
    names = args.sets or [*known, "nbrdf"]
    for name in names:
        if name not in (*known, "nbrdf"):
            raise InputError(f"--sets {name}: is none of {', '.join([*known, 'nbrdf'])}")
    result: dict[str, Any] = {"machine": platform.processor() or platform.machine(), "sets": {}}
    for name in names:
        if name == "nbrdf":
            result["nbrdf"] = real_nbrdf.measure(args.data / "nbrdf")
        else:
            result["sets"][name] = row = measure(known[name](args.data))
            _print(name, row)
        write_json(args.out, result)


def measure(real: real_sets.RealSet) -> dict[str, Any]:
    """Errors and costs of the material and of the peers on one set."""
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        real.write(work / "radiance.zarr")
        run(work, int((~real.held).sum()))
        trial = read_trial(Stack.open(work / "radiance.zarr"), read_labels(work / "labels.exr"), np.eye(3))
        row: dict[str, Any] = {"lights": len(trial.lights), "held_out": len(trial.held_out), "methods": {}}
        for method, label in (("slope", "lobes"), ("residual", "Kinran")):
            material, fit = read_material(work / f"{method}.exr"), read_json(work / f"{method}.json")
            row["methods"][label] = {
                **_errors(_middle(relight(material, trial.held_out), trial), trial),
                "bytes": fit["bytes_per_texel"],
                "microseconds": fit["microseconds_per_texel"],
            }
        row["residual"] = fit["residual"]
    row["methods"].update({name: _peer(name, trial) for name in PEERS})
    best = max(row["methods"][name]["psnr"] for name in COMPARED)
    if real.normals is not None:
        row["normals"] = _normals(real)
    row["above_the_best_peer"] = round(row["methods"]["Kinran"]["psnr"] - best, 2)
    return row


def _normals(real: real_sets.RealSet) -> dict[str, float]:
    """Mean angle to the true normals, in degrees, of Kinran's and of plain least squares, by all lights."""
    assert real.normals is not None
    truth = real.normals.reshape(-1, 3)
    there = np.linalg.norm(truth, axis=1) > 0.5
    T: Samples = np.array(np.moveaxis(real.light.reshape(len(real.light), -1, 3)[:, there], 0, -1), np.float32)
    sound = np.logical_not(real.saturated.reshape(len(real.light), -1, 3)[:, there].any(-1)).T
    plain = np.linalg.lstsq(real.directions, T.mean(1).T, rcond=None)[0].T
    plain /= np.linalg.norm(plain, axis=1, keepdims=True)
    found = {"Kinran": normals.fit(T, np.asarray(sound, np.float32), real.directions), "least squares": plain}
    angles = {name: np.degrees(np.arccos(np.clip((n * truth[there]).sum(1), -1, 1))) for name, n in found.items()}
    return {name: round(float(angle.mean()), 3) for name, angle in angles.items()}


def run(work: Path, lights: int) -> None:
    """The pipeline's stages on `radiance.zarr`, as its rules run them."""
    fit = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))["fit"]
    count, tail = (1, "ggx") if lights < FEW_LIGHTS else (fit["lobes"], fit["tail"])
    seen = ["--stack", work / "radiance.zarr", "--labels", work / "labels.exr"]
    regions, lobes = ["--regions", work / "regions.json"], ["--lobes", count, "--tail", tail]
    prior, slope = ["--prior", work / "prior.json"], work / "slope.exr"
    model: list[object] = ["--model", "slope"]
    _call(work, "segment", "--fabric", work)
    _call(work, "prior", work / "prior.json", *seen, *regions, *lobes)
    _call(work, "fit", work / "slope.npz", *seen, *model, *prior, *lobes)
    runs = ["--runs", work / "slope.npz"]
    _call(work, "material", slope, *seen, *regions, *model, *lobes, *runs, "--summary", work / "slope.json")
    made = ["--material", slope, "--fitted", work / "slope.json"]
    _call(work, "residual", work / "residual.exr", *seen, *prior, *made, "--summary", work / "residual.json")


def _call(work: Path, *arguments: object) -> None:
    log = work / "log.txt"
    with log.open("a", encoding="utf-8") as file, contextlib.redirect_stderr(file):
        status = kinran.main([str(argument) for argument in arguments])
    if status:
        raise InputError(f"kinran {arguments[0]}: did not finish: {log.read_text(encoding='utf-8')[-400:]}")


def _middle(images: Samples, trial: Trial) -> Samples:
    """Texels of the trial (texel, 3, light) of images (light, y, x, 3)."""
    n, height, width, _ = images.shape
    y, x = (height - trial.shape[0]) // 2, (width - trial.shape[1]) // 2
    cut = images[:, y : y + trial.shape[0], x : x + trial.shape[1]]
    return np.moveaxis(cut.reshape(n, -1, 3), 0, -1)


def _peer(name: str, trial: Trial) -> dict[str, float]:
    """Errors and costs of a peer in the values of the photographs."""
    channels, fit, predict = PEERS[name]
    T = trial.encoded()
    start = time.process_time()
    fitted = fit(T.reshape(-1, channels, T.shape[2]), trial.lights)
    micro = 1e6 * (time.process_time() - start) / trial.texels
    predicted = trial.decoded(predict(fitted, trial.held_out).reshape(trial.truth.shape))
    return {
        **_errors(predicted, trial),
        "bytes": round(6 / channels * fitted.numbers + 2 * fitted.shared / trial.texels, 1),
        "microseconds": round(micro, 2),
    }


def _errors(predicted: Samples, trial: Trial) -> dict[str, float]:
    """As `kinran evaluate` says them."""
    p, g, v = (np.moveaxis(a, -1, 0) for a in (predicted, trial.truth, trial.valid.astype(np.float32)))
    shown = [metrics.to_display(a, trial.coder, trial.peak) for a in (p, g)]
    by_light = [metrics.psnr(*pair) for pair in zip(*shown, v, strict=True)]
    return {
        "psnr": round(float(np.mean(by_light)), 3),
        "psnr_min": round(float(np.min(by_light)), 3),
        "relative_error": round(metrics.relative_error(p, g, v, trial.share), 5),
    }


def _print(name: str, row: dict[str, Any]) -> None:
    methods = row["methods"].items()
    print(f"\n{name}: {row['lights']} lights, {row['held_out']} held out; {row['residual']}")
    print("".join(f"{'':18s}" if label is None else f"{label:>12s}" for label in (None, *row["methods"])))
    for key in ("psnr", "psnr_min", "relative_error", "bytes", "microseconds"):
        print(f"{key:18s}" + "".join(f"{values[key]:12.5g}" for _, values in methods))
    if "normals" in row:
        print(f"mean error of the normals, degrees: {row['normals']}")
    print(f"above the best peer: {row['above_the_best_peer']:+.2f} dB", flush=True)
