"""What is trusted: lights that are elsewhere than they are listed, that flickered, and outliers, in real sets."""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks import real_sets, stages
from kinran.base import frames
from kinran.base.files import InputError, write_json
from kinran.compare import errors
from kinran.compare.trial import Trial
from kinran.compare.trial import read as read_trial
from kinran.data.fabric import Fabric
from kinran.data.texel_directions import Under
from kinran.fit import trust, under_priors
from kinran.fit.few_lights import FEW_LIGHTS
from kinran.fit.samples import Samples, spread_over_regions
from kinran.fit.slope_lobes import Lobes

SETS = ("item3", "item5", "item11", "material2")
TEXELS, SAMPLE = 4096, 512
"""Most texels of a set, and of a region from which is learned."""
EVERY, OUTLIERS, SEED = 20, 500, 3
"""One light of so many is made wrong, or one sample of so many."""
METHODS = {"as they are": False, "Huber's loss": True, "what fits in": None}
"""Whether samples are taken for outliers, with all lights trusted; None learns both."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--data", type=Path, help="folder of the real sets")
    parser.add_argument("--sets", nargs="+", default=SETS, help="which, of those of `kinran bench real`")
    parser.add_argument("--results", type=Path, nargs="*", default=[], help="results of fabrics, such as brocade")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    if args.data is None and not args.results:
        raise InputError("give the real sets (--data) or results of fabrics (--results)")
    rows = []
    for name, trial in trials(args):
        for row in measured(trial):
            rows.append({"set": name, **row})
            print(
                f"{name:10} {row['case']:9} {row['method']:13} {row['psnr']:6.2f} dB  relative error"
                f" {row['relative_error']:.4f}  wrong lights found {row['found']}/{row['wrong']},"
                f" others {row['falsely']}{', outliers' if row['outliers'] else ''}",
                flush=True,
            )
        write_json(args.out, {"rows": rows})


def trials(args: argparse.Namespace) -> Iterator[tuple[str, Trial]]:
    """Trials of the sets, with some of their texels."""
    known = real_sets.sets()
    for name in args.sets if args.data else ():
        if name not in known:
            raise InputError(f"--sets {name}: is none of {', '.join(known)}")
        with tempfile.TemporaryDirectory() as folder:
            known[name](args.data).write(Path(folder) / "radiance.zarr")
            with stages.quiet():
                yield name, read_trial(stages.segmented(Path(folder))).thinned(TEXELS)
    for path in args.results:
        yield path.name, read_trial(Fabric(path)).thinned(TEXELS)


def measured(trial: Trial) -> Iterator[dict[str, Any]]:
    """Errors under the held-out lights of each case by each method."""
    for case, samples, wrong in cases(trial.samples):
        for method, outliers in METHODS.items():
            if method == "Huber's loss" and len(wrong):
                continue
            yield {"case": case, "method": method, **fitted(trial, samples, wrong, outliers)}


def cases(samples: Samples) -> Iterator[tuple[str, Samples, NDArray[np.intp]]]:
    """Samples with something wrong, and which of their lights are."""
    rng = np.random.default_rng(SEED)
    count = samples.under.count
    wrong = np.sort(rng.choice(count, max(1, count // EVERY), replace=False))
    yield "clean", samples, wrong[:0]
    hit = rng.random((len(samples), 1, count)) < 1 / OUTLIERS
    level = rng.uniform(0, 1.5, hit.shape) * np.nan_to_num(samples.T).max((1, 2), keepdims=True)
    yield "outliers", replace(samples, T=np.where(hit, level, samples.T).astype(np.float32)), wrong[:0]
    theta, phi = frames.angles(samples.under.directions)
    theta[wrong] += np.radians(20) * np.where(theta[wrong] > 0.7, -1, 1)
    yield "turned", replace(samples, under=Under.far(frames.direction(theta, phi), len(samples))), wrong
    for case, factors in (("dark", (0.0,)), ("lamp 30 %", (0.7, 1.3))):
        T = samples.T.copy()
        T[:, :, wrong] *= np.resize(factors, len(wrong)).astype(np.float32)
        yield case, replace(samples, T=T), wrong


def fitted(trial: Trial, samples: Samples, wrong: NDArray[np.intp], outliers: bool | None) -> dict[str, Any]:
    """Fit as the stages do; what is trusted is learned if `outliers` is None."""
    lobes = Lobes("gaussian", 2) if samples.under.count >= FEW_LIGHTS else Lobes()
    regions = len(trial.regions)
    some = samples.of(np.flatnonzero(spread_over_regions(samples.region, regions, SAMPLE)))
    given = np.ones(samples.under.count, np.float32), bool(outliers)
    learn = trust.learn if outliers is None else lambda *_: given
    with patch.object(trust, "learn", learn):
        priors = under_priors.learn(some, regions, lobes)
    fit = under_priors.fit(samples.weighed(priors.lights), lobes, priors)
    predicted = trial.measured(fit)
    less = priors.lights < 1
    return {
        "psnr": round(float(errors.psnr(predicted, trial).mean()), 3),
        "relative_error": round(errors.ratio_of(*errors.squares(predicted, trial)), 5),
        "wrong": len(wrong),
        "found": int(less[wrong].sum()),
        "falsely": int(less.sum() - less[wrong].sum()),
        "outliers": bool(priors.outliers),
    }
