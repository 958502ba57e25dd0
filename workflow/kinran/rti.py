"""Run the pipeline on a folder of photographs with a `.lp` file: material, evaluation, render, report."""

import argparse
import os
import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import yaml

from kinran.code import ROOT
from kinran.files import InputError
from kinran.ingest import add_distances, distances, inspect

WORK = ".kinran"
"""Folder in OUT with the config, the sheets and the bookkeeping of the run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="photographs (JPEG, PNG, TIFF, EXR) and one .lp")
    parser.add_argument("--out", type=Path, required=True, metavar="OUT", help="folder of the results")
    parser.add_argument("--encoding", default="srgb", help="srgb (default), linear or gamma:EXPONENT")
    parser.add_argument("--crop", default="", metavar="X,Y,W,H", help="part to use, from the top left")
    parser.add_argument("--holdout", type=int, default=8, metavar="N", help="hold every Nth light out; 0: none")
    add_distances(parser)
    help_ = "photograph of a colour chart under the same light; without it, the encoding's colours are believed"
    parser.add_argument("--chart", type=Path, metavar="FILE", help=help_)
    help_ = "x,y of its corners from the top left, dark skin's first, then around; without it, it is found"
    parser.add_argument("--chart-corners", default="", metavar="X,Y,X,Y,X,Y,X,Y", help=help_)
    parser.add_argument("--lamp", default="", help="whose spectrum lights the chart: xenon, D50, D65, A, …")
    parser.add_argument("--cores", type=int, default=os.cpu_count())


def main(args: argparse.Namespace) -> None:
    """Write the config and run Snakemake on it."""
    if args.holdout < 0 or args.holdout == 1:
        raise InputError(f"--holdout {args.holdout}: give 0 for none, or 2 and more")
    folder, out, measured = args.folder.resolve(), args.out.resolve(), distances(args)
    inspect(folder, args.encoding, args.crop, args.holdout)
    cells = {name: "" if value is None else f"{value:.9f}" for name, value in asdict(measured).items()}
    cells["chart"] = str(args.chart.resolve()) if args.chart else ""
    cells |= {"chart_corners": args.chart_corners, "lamp": args.lamp}
    work = prepare(folder, out, args.encoding, args.crop, args.holdout, cells)
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "--snakefile",
        str(ROOT / "Snakefile"),
        "--directory",
        str(work),
    ]
    finished = subprocess.run([*command, "--cores", str(args.cores), "--quiet", "rules"], check=False)
    if finished.returncode:
        raise InputError(f"{out}: the run did not finish; the messages above and {work / 'logs'} say why")
    print(f"material    {args.out / 'material.exr'}")
    print(f"evaluation  {args.out / 'evaluation.json'}")
    print(f"report      {args.out / 'report.html'}")


def prepare(
    folder: Path, out: Path, encoding: str, crop: str, holdout: int, cells: dict[str, str] | None = None
) -> Path:
    """Write the config and the sheet of one set into OUT; returns the working directory of the run.

    `cells` are those of further columns of the sheet. The results of the fabric are OUT itself: `results/<fabric>` in
    the working directory leads there.
    """
    fabric = re.sub(r"[^a-z0-9_-]+", "-", out.name.lower()).strip("-_") or "fabric"
    work = out / WORK
    try:
        (work / "config").mkdir(parents=True, exist_ok=True)
        (work / "results").mkdir(exist_ok=True)
        link = work / "results" / fabric
        if not link.is_symlink():
            link.symlink_to(out, target_is_directory=True)
        defaults = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
        defaults.update(holdout=holdout)
        defaults["rig"]["device"] = "none"
        defaults["scene"]["template"] = str(ROOT / defaults["scene"]["template"])
        (work / "config.yaml").write_text(yaml.safe_dump(defaults, sort_keys=False), encoding="utf-8")
        row = {"fabric": fabric, "source": str(folder), "encoding": encoding, "crop": crop, "regions": "", "seeds": ""}
        row |= cells or {}
        rows = ["\t".join(row), "\t".join(row.values())]
        (work / "config" / "fabrics.tsv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        (work / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written to ({error.strerror}); choose another output folder") from None
    return work
