"""Benchmarks: claims of speed and accuracy, measured on this machine; JSON out and a table."""

import argparse
import importlib
import sys
from types import ModuleType

from kinran.base.files import InputError
from kinran.base.project import ROOT

NAMES = (
    "adaptive", "camera", "chart", "choice", "doubts", "fabrics", "fit", "flips", "merge", "mixed", "neural", "objects",
    "plan", "real", "rig-kills", "run-kills", "size", "stability", "trust",
)  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command; those of the benchmark follow its name."""
    parser.add_argument("benchmark", choices=NAMES, help="what is measured")
    parser.add_argument("rest", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    parser.epilog = "kinran bench NAME --help says what a benchmark takes."


def main(args: argparse.Namespace) -> None:
    """Run a benchmark."""
    if not (ROOT / "benchmarks" / "__init__.py").is_file():
        raise InputError(f"{ROOT}: has no benchmarks; work in a clone of the project")
    sys.path.insert(0, str(ROOT))
    benchmark = load(args.benchmark)
    parser = argparse.ArgumentParser(prog=f"kinran bench {args.benchmark}", description=benchmark.__doc__)
    benchmark.add_arguments(parser)
    benchmark.main(parser.parse_args(args.rest))


def load(name: str) -> ModuleType:
    """Return the module of a benchmark."""
    return importlib.import_module(f"benchmarks.{name.replace('-', '_')}")
