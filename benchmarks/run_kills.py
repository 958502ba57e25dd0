"""Kill -9 in whole runs: of jobs, of Snakemake with and without its jobs, and of the command around it.

A small project, a fabric on the virtual rig and one in photographs, is run again after each kill, with no more than the
same command, until it is finished. Its files must then be those of an undisturbed run.
"""

import argparse
import importlib
import resource
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from kinran.base.files import write_json
from kinran.base.project import ROOT

sys.path.insert(0, str(ROOT / "tests" / "helpers"))  # the project of the tests


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--kills", type=int, default=100, help="kills, in as many projects as that takes")
    parser.add_argument("--seed", type=int, default=0, help="seed of what is killed, and when")
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Kill, print what was found, write the JSON."""
    campaign = importlib.import_module("killed_runs").campaign
    with tempfile.TemporaryDirectory(prefix="kinran-kills-") as folder:
        tally = campaign(Path(folder), args.kills, args.seed)
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    results = asdict(tally) | {"seed": args.seed, "cpu_s": round(sum(use.ru_utime + use.ru_stime for use in spent), 1)}
    for name, value in results.items():
        print(f"{name:10} {value}")
    if args.out:
        write_json(args.out, results)
