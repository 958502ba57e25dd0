"""The chart on a path-traced brocade under the paper's full grid, by the pipeline's own stages, and its targets.

The brocade, its lights, their split and the noise are those of `kinran bench fit`. Held-out lights have the same noise
as the others.
"""

import argparse
import logging
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import fit, stages
from kinran.base.files import write_json
from kinran.compare import chart, chart_page, chart_table, default, rows
from kinran.compare.methods import kinds
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.virtual.sensor import Sensor, shutter
from kinran_bsdf.colours import TO_REC709

log = logging.getLogger(__name__)

EXPOSURES = (25, 100, 250, 1000, 4000)
"""Shutter speeds of the paper's bracket, 1/s, which set the radiance that the bracket can hold."""
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
"""Name, experiment, setting, method (the beginning of its name), measure, and largest value that meets the target."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--out", type=Path, required=True, help="folder for the stack, the material and the chart")
    parser.add_argument("--cache", type=Path, default=fit.CACHE, help="where rendered lights are kept")


def main(args: argparse.Namespace) -> None:
    """Run the stages, chart all methods, print the targets and write them as JSON."""
    args.out.mkdir(parents=True, exist_ok=True)
    write_stack(fit.truth(args.cache), args.out / "radiance.zarr")
    stages.segmented(args.out)
    stages.fitted(args.out, 2, "gaussian")  # as in config.yaml
    charted(args.out)
    found = targets(args.out / "chart.csv")
    write_json(args.out / "targets.json", found)
    for row in found:
        print(f"{row['what']:32s} {row['value']:.4g}  ({'met' if row['met'] else 'missed'}: at most {row['most']:g})")


def write_stack(scene: fit.Truth, folder: Path) -> None:
    """Write the noisy samples as a radiance stack, with every fourth light of a ring held out."""
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


def charted(folder: Path) -> None:
    """Chart all methods and the default, kind by kind, and write one table, its pictures and the page."""
    inputs = chart.Inputs(folder, folder / "material.exr", folder / "slope.json")
    parts = []
    for kind in [default.FAMILY, *kinds()]:
        log.info("bench chart: %s", kind)
        part = folder / f"{kind}.csv"
        chart.main(inputs, part, chart.Options(NAME, kind))
        parts += rows.read(part)
    chart_table.write(folder / "chart.csv", parts, [folder / "chart.svg", folder / "chart.png"])
    chart_page.main(chart_page.Inputs((folder / "chart.csv",)), folder / "chart.html")


def targets(table: Path) -> list[dict[str, Any]]:
    """Targets with the chart's values, and whether they are met."""
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
