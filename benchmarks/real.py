"""Accuracy of the pipeline's material on held-out lights of real sets, beside interpolation and harmonics."""

import argparse
import platform
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from benchmarks import real_nbrdf, real_sets, stages
from kinran.base import frames
from kinran.base.files import InputError, read_json, write_json
from kinran.base.project import ROOT
from kinran.compare import errors
from kinran.compare.baselines import basis, components, interpolation
from kinran.compare.default import said
from kinran.compare.method import bytes_per_texel
from kinran.compare.methods.plates import SMOOTHING
from kinran.compare.trial import Trial, middle
from kinran.compare.trial import read as read_trial
from kinran.data.fabric import Fabric
from kinran.data.radiance_stack import Stack
from kinran.fit import lambert, residual
from kinran.fit.cross_validation import surrounded
from kinran.fit.few_lights import FEW_LIGHTS
from kinran.fit.fitted_model import Fitted
from kinran.fit.harmonics import harmonics
from kinran.fit.lambert_normals import normals
from kinran.fit.samples import Samples
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.relight import relight

Single = NDArray[np.float32]

PLATE = interpolation.thin_plate(SMOOTHING)
PEERS: dict[str, tuple[int, Callable[[Samples], Fitted]]] = {
    "PTM": (3, lambda samples: basis.fit(samples, basis.polynomial)),
    "HSH16": (3, lambda samples: basis.fit(samples, harmonics(16), basis.RIDGE)),
    "PCA9": (1, lambda samples: components.fit(samples, 9, PLATE)),
    "Delaunay": (3, lambda samples: interpolation.fit(samples, interpolation.linear)),
    "thin plate": (3, lambda samples: interpolation.fit(samples, PLATE)),
}
"""Number of channels that share their numbers, and function that fits. PCA takes each channel of a texel by itself."""
COMPARED = ("PTM", "HSH16", "PCA9", "Lambert")
"""Peers of some ten numbers per texel, like the material; the others keep all samples."""
EVERYWHERE, DARK = 2000, 0.01
"""Directions of light over the hemisphere at which no texel may be a spark, and the least brightness, over white, that
sparks are measured by. Choices."""


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
            print_row(name, row)
        write_json(args.out, result)


def measure(real: real_sets.RealSet, rivals: Mapping[str, Callable[[Trial], dict[str, Any]]] = {}) -> dict[str, Any]:
    """Errors and costs of the material, of the peers and of more rivals on one set."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        real.write(folder / "radiance.zarr")
        with stages.quiet():
            run(folder, int((~real.held).sum()))
        fabric = Fabric(folder)
        trial = read_trial(fabric)
        row: dict[str, Any] = {"lights": len(trial.lights), "held_out": trial.held.count, "methods": {}}
        for label, maps, cost in (("lobes", "material", "slope"), ("Kinran", "residual", "residual")):
            fit = read_json(folder / f"{cost}.json")
            row["methods"][label] = {
                **errors_of(said(read_material(folder / f"{maps}.exr"), fabric.stack), trial),
                "bytes": fit["bytes_per_texel"],
                "microseconds": fit["microseconds_per_texel"],
            }
        row["residual"] = fit["residual"]
        material = read_material(folder / "residual.exr")
        row["promise"] = _promise(trial, fit["residual"], material, fabric.stack)
        y0, y1, x0, x1 = middle(fabric.stack)
        row["brightest_between"] = _brightest_between(material.part(slice(y0, y1), slice(x0, x1)), trial)
    row["methods"].update({name: _peer(name, trial) for name in PEERS})
    row["methods"]["Lambert"] = _lambert(trial)
    row["methods"].update({name: rival(trial) for name, rival in rivals.items()})
    best = max(row["methods"][name]["psnr"] for name in COMPARED)
    if real.normals is not None:
        row["normals"] = _normals(real)
    row["above_the_best_peer"] = round(row["methods"]["Kinran"]["psnr"] - best, 2)
    return row


def _normals(real: real_sets.RealSet) -> dict[str, float]:
    """Mean angles to the true normals, in degrees, of Kinran's normals and of least squares, from all lights."""
    assert real.normals is not None
    truth = real.normals.reshape(-1, 3)
    there = np.linalg.norm(truth, axis=1) > 0.5
    T: Single = np.array(np.moveaxis(real.light.reshape(len(real.light), -1, 3)[:, there], 0, -1), np.float32)
    sound = np.logical_not(real.saturated.reshape(len(real.light), -1, 3)[:, there].any(-1)).T
    plain = np.linalg.lstsq(real.directions, T.mean(1).T, rcond=None)[0].T
    plain /= np.linalg.norm(plain, axis=1, keepdims=True)
    samples = Samples.far(T, np.asarray(sound, np.float32), real.directions)
    found = {"Kinran": normals(samples), "least squares": plain}
    angles = {name: np.degrees(np.arccos(np.clip((n * truth[there]).sum(1), -1, 1))) for name, n in found.items()}
    return {name: round(float(angle.mean()), 3) for name, angle in angles.items()}


def run(folder: Path, lights: int) -> None:
    """Run the pipeline's stages on ``radiance.zarr`` as its rules run them for so many lights."""
    fit = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))["fit"]
    stages.segmented(folder)
    if lights < FEW_LIGHTS:
        stages.fitted(folder, 1, "ggx")
    else:
        stages.fitted(folder, fit["lobes"], fit["tail"])
    given = residual.Inputs(folder, folder / "prior.json", folder / "material.exr", folder / "slope.json")
    residual.main(given, residual.Outputs(folder / "residual.exr", folder / "residual.json"))


def _peer(name: str, trial: Trial) -> dict[str, float]:
    """Errors and costs of a peer in the values of the photographs."""
    channels, fit = PEERS[name]
    seen = trial.encoded()
    T = seen.T.reshape(-1, channels, seen.under.count)
    samples = Samples.far(T, np.repeat(seen.W, 3 // channels, axis=0), seen.under.directions)
    start = time.process_time()
    fitted = fit(samples)
    micro = 1e6 * (time.process_time() - start) / trial.texels
    predicted = trial.decoded(fitted.predict(trial.held).reshape(trial.truth.shape))
    return {
        **errors_of(predicted, trial),
        "bytes": round(3 / channels * bytes_per_texel(fitted, len(samples)), 1),
        "microseconds": round(micro, 2),
    }


def _lambert(trial: Trial) -> dict[str, float]:
    """Errors and costs of the diffuse term alone, on facets."""
    start = time.process_time()
    fitted = lambert.fit(trial.samples)
    micro = 1e6 * (time.process_time() - start) / trial.texels
    numbers = {"bytes": 2 * fitted.numbers, "microseconds": round(micro, 2)}
    return {**errors_of(trial.measured(fitted), trial), **numbers}


def _promise(trial: Trial, chosen: dict[str, Any], material: Material, stack: Stack) -> dict[str, Any]:
    """PSNR in dB that cross-validation promised, and that under the held-out lights which others surround."""
    training = trial.samples.under.directions
    inside = surrounded(trial.held.directions, training)
    by_light = errors.psnr(said(material, stack), trial)[inside]
    held_out = float(by_light.mean()) if inside.any() else float("nan")
    return {
        "promised": chosen["cross_validated_psnr"],
        "held_out": round(held_out, 3),
        "lights": int(inside.sum()),
        "promised_by_theta": chosen["by_theta"],
        "held_out_by_theta": residual.by_theta(by_light, trial.held.directions[inside]),
    }


def _brightest_between(material: Material, trial: Trial) -> float:
    """Largest value of a texel under `EVERYWHERE` lights of the hemisphere, over its brightest photograph.

    Texels whose brightest sample is under `DARK` of the set's white count as that bright.
    """
    k = np.arange(EVERYWHERE) + 0.5
    lights = frames.direction(np.arccos(1 - k / EVERYWHERE), k * np.pi * (3 - 5**0.5))
    brightest = np.zeros((trial.texels, 3), np.float32)
    for part in np.array_split(lights, EVERYWHERE // 40):
        seen = relight(material, part).reshape(len(part), trial.texels, 3)
        brightest = np.maximum(brightest, seen.max(0))
    sampled = np.where(trial.samples.W[:, None] > 0, trial.samples.T, 0).max((1, 2))
    return round(float((brightest.max(1) / np.maximum(sampled, DARK * trial.peak)).max()), 2)


def errors_of(predicted: Single, trial: Trial) -> dict[str, float]:
    """Errors as `kinran evaluate` computes them."""
    by_light = errors.psnr(predicted, trial)
    return {
        "psnr": round(float(by_light.mean()), 3),
        "psnr_min": round(float(by_light.min()), 3),
        "relative_error": round(errors.ratio_of(*errors.squares(predicted, trial)), 5),
    }


def print_row(name: str, row: dict[str, Any]) -> None:
    """Print the table of a set."""
    methods = row["methods"].items()
    print(f"\n{name}: {row['lights']} lights, {row['held_out']} held out; {row['residual']}")
    print("".join(f"{'':18s}" if label is None else f"{label:>12s}" for label in (None, *row["methods"])))
    for key in ("psnr", "psnr_min", "relative_error", "bytes", "microseconds"):
        print(f"{key:18s}" + "".join(f"{values[key]:12.5g}" for _, values in methods))
    print(f"promise {row['promise']}; brightest between lights, over brightest sample: {row['brightest_between']}")
    if "normals" in row:
        print(f"mean error of the normals, degrees: {row['normals']}")
    print(f"above the best peer: {row['above_the_best_peer']:+.2f} dB", flush=True)
