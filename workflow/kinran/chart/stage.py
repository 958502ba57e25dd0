"""Chart accuracy against speed: methods on the same held-out lights of one fabric.

All methods, the baselines too, see training lights alone. Of maps larger than 128 × 128 texels the middle is
taken. What each column means stands in docs/chart.md.
"""

import argparse
from pathlib import Path

from kinran.chart import default, experiments, rows, table, trial
from kinran.chart.method import Method
from kinran.chart.methods import kinds, methods, of
from kinran.files import InputError, check_name
from kinran.labels import read_labels, read_regions, read_second
from kinran.stack import Stack
from kinran_bsdf.colours import TO_REC709


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--fabric", required=True)
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--kind", choices=[*kinds(), "default"], help="of method (default: all of them)")
    parser.add_argument("--material", type=Path, help="the default: material (.exr)")
    parser.add_argument("--summary", type=Path, help="what the default cost (.json)")
    parser.add_argument("--pictures", type=Path, nargs="+", default=[], help="the chart as .svg and .png")
    parser.add_argument("out", type=Path, help="table (.csv)")


def main(args: argparse.Namespace) -> None:
    """Write the table and the pictures, and say where the default stands."""
    fabric = check_name(args.fabric, "fabric")
    stack = Stack.open(args.stack)
    tried = trial.read(stack, read_labels(args.labels), TO_REC709 @ stack.to_acescg, read_second(args.labels))
    names = [region.name for region in read_regions(args.regions)]
    found = []
    if args.kind in (None, default.FAMILY):
        if not (args.material and args.summary):
            raise InputError(f"{args.out}: the default needs --material and --summary; give both, or a --kind")
        found += default.run(tried, fabric, names, stack, args.material, args.summary)
    chosen: list[Method] | tuple[Method, ...] = of(args.kind) if args.kind in kinds() else []
    found += experiments.run(tried, fabric, names, chosen if args.kind else methods())
    if args.kind:
        rows.write(args.out, found)
    else:
        table.write(args.out, found, args.pictures)
