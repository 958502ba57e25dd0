"""Chart accuracy against speed: every method on the same held-out lights of one fabric.

All methods, the baselines too, see training lights alone. Of maps larger than 128 × 128 texels the middle is
taken. What each column means stands in docs/chart.md.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np

from kinran import canvas
from kinran.chart import experiments, figure, front, rows, trial
from kinran.files import InputError, check_name, read_json
from kinran.labels import read_labels, read_regions
from kinran.stack import Stack
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import read_material
from kinran_bsdf.models import relight


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--fabric", required=True)
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--material", type=Path, required=True, help="the default: material (.exr)")
    parser.add_argument("--summary", type=Path, required=True, help="what the default cost (.json)")
    parser.add_argument("--pictures", type=Path, nargs="+", default=[], help="the chart as .svg and .png")
    parser.add_argument("out", type=Path, help="table (.csv)")


def main(args: argparse.Namespace) -> None:
    """Write the table and the pictures, and say where the default stands."""
    fabric = check_name(args.fabric, "fabric")
    stack = Stack.open(args.stack)
    tried = trial.read(stack, read_labels(args.labels), TO_REC709 @ stack.to_acescg)
    names = [region.name for region in read_regions(args.regions)]
    default = _default(args.material, args.summary, stack, tried)
    table = experiments.run(tried, fabric, names, default)
    rows.write(args.out, table)
    drawing = figure.draw(table)
    for path in args.pictures:
        canvas.write(path, drawing)
    for sentence in front.verdict(table):
        print(sentence, file=sys.stderr)


def _default(
    material: Path, summary: Path, stack: Stack, tried: trial.Trial
) -> tuple[str, trial.Samples, dict[str, float]]:
    """Name, predictions (texel, 3, light) and cost of the material that the pipeline wrote."""
    maps = read_material(material)
    if maps.size != (stack.height, stack.width):
        raise InputError(f"{material}: its size is not that of {stack.path}; fit it again")
    height, width = tried.shape
    y, x = (stack.height - height) // 2, (stack.width - width) // 2
    images = relight(maps.part(slice(y, y + height), slice(x, x + width)), tried.held_out)
    predicted = np.ascontiguousarray(images.reshape(len(images), -1, 3).transpose(1, 2, 0))
    cost: dict[str, Any] = read_json(summary)
    known = {"microseconds": "microseconds_per_texel", "bytes": "bytes_per_texel"}
    values = {name: float(cost[key]) for name, key in known.items() if key in cost}
    return f"default ({cost.get('model', maps.model)})", predicted, values
