"""Run the whole pipeline with the project's config: by default the virtual rig, with no hardware and no data."""

import argparse
import os
import subprocess
import sys

from kinran.code import ROOT
from kinran.files import InputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--cores", type=int, default=os.cpu_count())


def main(args: argparse.Namespace) -> None:
    """Run Snakemake and say where to look."""
    command = [sys.executable, "-m", "snakemake", "--cores", str(args.cores), "--quiet", "rules"]
    if subprocess.run(command, cwd=ROOT, check=False).returncode:
        raise InputError("the run did not finish; the messages above and the folder logs say why")
    print("open results/report.html; the picture is results/brocade/render.png")
