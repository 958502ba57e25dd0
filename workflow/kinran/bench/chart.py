"""The chart on a path-traced brocade under the paper's full grid, through the pipeline's own stages; and the targets.

The brocade, its lights, the split of them and the noise are those of `kinran bench fit`.
The lights held out have the noise of the others.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from kinran.bench import fit
from kinran.files import InputError, write_json
from kinran.radiance.value import Radiance
from kinran.stack import Light, Metadata, write_metadata, write_shards
from kinran.virtual.sensor import Sensor, shutter
from kinran_bsdf.colours import TO_REC709

EXPOSURES = (25, 100, 250, 1000, 4000)
"""Shutter speeds of the paper's bracket, 1/s: what can be held is known by them."""
NAME = "full-grid"
TARGETS = (
    ("one lobe", "all", "", "GGX lobe", "relative_error", 0.08),
    ("two lobes", "all", "", "2 Gaussian lobes", "relative_error", 0.06),
    ("default", "all", "", "default", "relative_error", 0.055),
    ("default, bytes a texel", "all", "", "default", "bytes", 45),
    ("50 directions", "directions", "50", "default", "relative_error", 0.20),
    ("50 directions, texels above 1", "directions", "50", "default", "texels_above_1", 0),
    ("30 directions", "directions", "30", "default", "relative_error", 0.25),
)
"""What, experiment, setting, method (how its name begins), measure, most."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--out", type=Path, required=True, help="folder for the stack, the material and the chart")
    parser.add_argument("--cache", type=Path, default=fit.CACHE, help="where rendered lights are kept")


def main(args: argparse.Namespace) -> None:
    """Run the stages, chart all methods, print the targets and write them as JSON."""
    args.out.mkdir(parents=True, exist_ok=True)
    write_stack(fit.truth(args.cache), args.out / "radiance.zarr")
    for command in commands(args.out):
        _run(command)
    found = targets(args.out / "chart.csv")
    write_json(args.out / "targets.json", found)
    for row in found:
        print(f"{row['what']:32s} {row['value']:.4g}  ({'met' if row['met'] else 'missed'}: at most {row['most']:g})")


def write_stack(scene: fit.Truth, folder: Path) -> None:
    """Write what the camera saw as a radiance stack, every fourth light of a ring held out."""
    side = fit.FABRIC.texels
    theta = np.degrees(np.arccos(np.clip(scene.lights[:, 2], -1, 1)))
    phi = np.degrees(np.arctan2(scene.lights[:, 1], scene.lights[:, 0])) % 360
    lights = tuple(
        Light(
            f"t{t:02.0f}_p{p:03.0f}",
            tuple(direction.tolist()),
            grid=(round(t / 5), round(p / 5) % 72),
            held_out=bool(held),
        )
        for t, p, direction, held in zip(theta, phi, scene.lights, scene.held, strict=True)
    )
    images = scene.seen.reshape(len(lights), side, side, 3)
    write_shards(folder, 0, Radiance.unflagged(images))
    sensor = Sensor()
    noise = {
        "kind": "raw",
        "seconds": [shutter(1 / speed) for speed in EXPOSURES],
        "white_counts_per_second": [sensor.rate / sensor.gain] * 3,
        "saturation_counts": sensor.full_well / sensor.gain,
    }
    texel_mm = fit.FABRIC.field_mm / side
    to_acescg = np.linalg.inv(TO_REC709)
    write_metadata(folder, Metadata(lights, side, side, texel_mm, "", "", "Rec. 709", to_acescg, noise))


def commands(out: Path) -> list[list[str]]:
    """Command lines of the stages, with the defaults of the config."""

    def at(**files: str) -> list[str]:
        return [part for name, file in files.items() for part in (f"--{name}", str(out / file))]

    stack, labels, regions = at(stack="radiance.zarr"), at(labels="labels.exr"), at(regions="regions.json")
    slope = ["--lobes", "2", "--tail", "gaussian"]
    model, prior, summary = ["--model", "slope", *slope], at(prior="prior.json"), at(summary="slope.json")
    fabric, pictures = ["--fabric", NAME], ["--pictures", str(out / "chart.svg"), str(out / "chart.png")]

    def command(stage: str, file: str, *parts: list[str]) -> list[str]:
        return [stage, str(out / file), *(word for part in parts for word in part)]

    return [
        ["segment", "--fabric", str(out)],
        command("prior", "prior.json", stack, labels, regions, slope),
        command("fit", "slope.npz", stack, labels, model, prior),
        command("material", "material.exr", stack, labels, regions, model, at(runs="slope.npz"), summary),
        command("chart", "chart.csv", stack, labels, regions, at(material="material.exr"), summary, pictures, fabric),
        command("charts", "chart.html", at(charts="chart.csv")),
    ]


def _run(command: list[str]) -> None:
    from kinran.__main__ import main as kinran

    print("kinran " + " ".join(command), file=sys.stderr, flush=True)
    if kinran(command):
        raise InputError(f"{command[1]}: kinran {command[0]} failed; what it said stands above")


def targets(table: Path) -> list[dict[str, Any]]:
    """What each target asks and what the chart has for it."""
    from kinran.chart import rows

    found = []
    for what, experiment, setting, method, measure, most in TARGETS:
        row = next(
            row
            for row in rows.read(table)
            if (row.experiment, row.setting) == (experiment, setting) and row.method.startswith(method)
        )
        value = row[measure]
        found.append({"what": what, "method": row.method, "value": value, "most": most, "met": value <= most})
    return found
