"""The neural rival on real sets: autoencoders in the shapes of NeuralRTI and DisK-NeuralRTI beside the material."""

import argparse
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import real, real_sets
from kinran.base.files import InputError, write_json
from kinran.compare.baselines import neural
from kinran.compare.method import bytes_per_texel
from kinran.compare.trial import Trial

STEPS = {"DisK-NeuralRTI": 60_000, "NeuralRTI": 20_000}
"""Steps of training of each kind: some minutes, and a quarter of an hour. Choices."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--data", type=Path, required=True, help="folder of the real sets")
    parser.add_argument("--sets", nargs="+", default=["item3"], help="which, of those of `kinran bench real`")
    parser.add_argument("--kinds", nargs="+", choices=list(STEPS), default=list(STEPS), help="which autoencoders")
    parser.add_argument("--steps", type=int, help="steps of training; those of the kind if not given")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Train, measure, print a table, write JSON."""
    known, rows = real_sets.sets(), {}
    for name in args.sets:
        if name not in known:
            raise InputError(f"--sets {name}: is none of {', '.join(known)}")
    for name in args.sets:
        rivals = {kind: partial(rival, kind, args.steps or STEPS[kind]) for kind in args.kinds}
        rows[name] = real.measure(known[name](args.data), rivals)
        real.print_row(name, rows[name])
        write_json(args.out, {"sets": rows})


def rival(kind: str, steps: int, trial: Trial) -> dict[str, Any]:
    """Errors and costs of an autoencoder, trained on the values of the photographs."""
    seen = trial.encoded()
    start = time.process_time()
    fitted = neural.KINDS[kind](replace(seen, W=(seen.W > 0).astype(np.float32)), steps)
    fitting = time.process_time() - start
    start = time.process_time()
    predicted = trial.decoded(fitted.predict(trial.held))
    decoding = time.process_time() - start
    return {
        **real.errors_of(predicted, trial),
        "bytes": round(bytes_per_texel(fitted, trial.texels), 1),
        "microseconds": round(1e6 * fitting / trial.texels, 2),
        "decode_microseconds": round(1e6 * decoding / trial.texels / trial.held.count, 3),
    }
