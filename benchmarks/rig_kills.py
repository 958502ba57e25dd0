"""Kill -9 at random steps of captures: frames that are lost, shot again, or left on the card.

The rig and the camera are simulated and live on in this process; the hosts are processes of their own. A step is a call
to the camera, half a write to the journal, a sync, or a rename.
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

sys.path.insert(0, str(ROOT / "tests" / "fault"))  # the bench of the fault tests


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--kills", type=int, default=2000, help="hosts that are killed")
    parser.add_argument("--seed", type=int, default=0, help="seed of the steps at which they are killed")
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Kill, print the table, write the JSON."""
    campaign = importlib.import_module("capture_kills").campaign
    with tempfile.TemporaryDirectory(prefix="kinran-kills-") as folder:
        tally = campaign(Path(folder), args.kills, args.seed)
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    results = asdict(tally) | {"seed": args.seed, "cpu_s": round(sum(use.ru_utime + use.ru_stime for use in spent), 1)}
    for name, value in results.items():
        print(f"{name:10} {value:>8}")
    if args.out:
        write_json(args.out, results)
