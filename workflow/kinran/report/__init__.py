"""Write the report of a fabric: one HTML page that needs nothing else."""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--fabric", required=True)
    parser.add_argument("--results", type=Path, required=True, help="folder of the fabric's results")
    parser.add_argument("--captures", type=Path, required=True, help="folder of the fabric's capture")
    parser.add_argument("--choice", type=Path, help="what `kinran choice` chose (.json), if it was asked")
    parser.add_argument("out", type=Path, help="page (.html)")


def main(args: argparse.Namespace) -> None:
    """Gather and write."""
    from kinran.report.fabric import gather
    from kinran.report.page import write_page

    write_page(args.out, "fabric.html", gather(args.fabric, args.results, args.captures, args.choice))
