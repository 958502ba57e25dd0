"""Choose the simplest lobes that explain a fabric, by cross-validation over lights with a stated cost a byte."""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import encoding, metrics
from kinran.files import InputError, read_json, write_json
from kinran.fit import lambert, samples, slope
from kinran.fit.lobes import TAILS
from kinran.fit.predict import predict
from kinran.fit.sampled import of_regions
from kinran.labels import read_labels, read_regions
from kinran.stack import Stack

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Labels = NDArray[np.intp]

SAMPLE = 256
"""Texels of a region that the choice is made on."""
FOLDS, FEW_FOLDS, MANY_LIGHTS = 10, 4, 256
DB_A_BYTE = 0.3 / 16
"""What a byte a texel has to gain in cross-validated PSNR: 0.3 dB a lobe, which has 16 bytes."""
MOST_DB = 60.0


@dataclass(frozen=True)
class Candidate:
    """A kind of material: its name, tail, number of lobes, and numbers a texel."""

    name: str
    tail: str
    lobes: int
    numbers: int

    @property
    def size(self) -> int:
        """Bytes a texel, at half precision."""
        return 2 * self.numbers


CANDIDATES = (
    Candidate("lambert", "ggx", 0, 3),
    Candidate("one GGX lobe", "ggx", 1, 13),
    Candidate("two Gaussian lobes", "gaussian", 2, 21),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="what was chosen, and why (.json)")


def main(args: argparse.Namespace) -> None:
    """Judge the candidates on a sample of each region, choose, and write both."""
    stack = Stack.open(args.stack)
    names = [region.name for region in read_regions(args.regions)]
    labels = read_labels(args.labels)
    T, W, region = of_regions(stack, labels, len(names), SAMPLE)
    share = np.bincount(labels.ravel(), minlength=len(names)) / labels.size
    judged = judge(T, W, region, stack, args.threads)
    chosen, kinds = choose(judged, share)
    bytes_needed = float(share @ [kind.size for kind in kinds])
    write_json(
        args.out,
        {
            "tail": chosen.tail,
            "lobes": chosen.lobes,
            "fitted": [k for k, kind in enumerate(kinds) if kind.lobes],
            "decibels_a_byte": DB_A_BYTE,
            "bytes_per_texel": round(bytes_needed, 1),
            "bytes_saved": round(CANDIDATES[-1].size - bytes_needed, 1),
            "regions": {
                name: {"chosen": kind.name, **{c.name: judged[c.name].row(k) for c in CANDIDATES}}
                for k, (name, kind) in enumerate(zip(names, kinds, strict=True))
            },
        },
    )
    print(f"choice: {', '.join(f'{n}: {kind.name}' for n, kind in zip(names, kinds, strict=True))}", file=sys.stderr)


@dataclass(frozen=True)
class Judgement:
    """Of a candidate, by region.

    Attributes
    ----------
    square : (light, region)
        Mean squared error of displayed values under each training light while that was left out.
    relative : (region,)
        √(Σ (m - g)² / Σ g²) in linear light, over lights left out.
    bic, aic : (region,)
        Means over texels of n ln(RSS / n) + k ln n and … + 2 k, of the fit to all training lights.
    """

    square: Array
    relative: Array
    bic: Array
    aic: Array

    def psnr(self, share: Array) -> float:
        """Mean over lights, in dB, of regions that have these shares of the fabric."""
        error = self.square @ (share / share.sum())
        return float(np.mean(np.minimum(-10 * np.log10(np.maximum(error, 1e-12)), MOST_DB)))

    def row(self, region: int) -> dict[str, float]:
        """Figures of a region, as the file holds them."""
        only = np.eye(len(self.relative))[region]
        values = {"psnr": self.psnr(only), "relative_error": self.relative[region]}
        values |= {"bic": self.bic[region], "aic": self.aic[region]}
        return {name: float(f"{value:.5g}") for name, value in values.items()}


def judge(T: Single, W: Single, region: Labels, stack: Stack, threads: int) -> dict[str, Judgement]:
    """Cross-validate the candidates; priors are learnt anew in each fold, from its lights alone."""
    lights = samples.training_directions(stack)
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    peak = float(np.percentile(T, 99.9)) or 1.0
    count, n = int(region.max()) + 1, len(lights)
    one_of = np.eye(count)[region]
    usable = (W > 0)[:, None] & np.isfinite(T)
    shown = metrics.to_display(T, coder, peak)
    fold = np.random.default_rng(0).permutation(n) % (FOLDS if n <= MANY_LIGHTS else FEW_FOLDS)
    result = {}
    for candidate in CANDIDATES:
        predicted = np.empty_like(T)
        for k in range(fold.max() + 1):
            train, test = fold != k, fold == k
            seen = np.ascontiguousarray(T[:, :, train]), np.ascontiguousarray(W[:, train])
            predicted[:, :, test] = _predicted(candidate, *seen, lights[train], lights[test], region, count, threads)
        off = usable * (metrics.to_display(predicted, coder, peak) - shown) ** 2
        square = np.einsum("tcl,tr->lr", off, one_of) / np.maximum(np.einsum("tcl,tr->lr", usable, one_of), 1)
        error, energy = (usable * (predicted - T) ** 2).sum((1, 2)), (usable * T**2).sum((1, 2))
        relative = np.sqrt((error @ one_of) / np.maximum(energy @ one_of, 1e-30))
        left = _predicted(candidate, T, W, lights, lights, region, count, threads) - T
        size = np.maximum(usable.sum((1, 2)), 1)
        fit = size * np.log(np.maximum((W[:, None] * usable * left**2).sum((1, 2)), 1e-30) / size)
        texels = np.maximum(one_of.sum(0), 1)
        bic, aic = (fit + candidate.numbers * weight for weight in (np.log(size), 2.0))
        result[candidate.name] = Judgement(square, relative, bic @ one_of / texels, aic @ one_of / texels)
    return result


def _predicted(
    candidate: Candidate, T: Single, W: Single, lights: Array, others: Array, region: Labels, count: int, threads: int
) -> Single:
    """T (texel, 3, light) under other lights, of a fit to these."""
    if not candidate.lobes:
        return (lambert.fit(T, W, lights)[:, :, None] * others[:, 2]).astype(np.float32)
    kind = candidate.tail, candidate.lobes
    priors = slope.learn_priors(T, W, lights, region, count, *kind, threads)
    return predict(slope.fit(T, W, lights, *kind, priors, region, threads), others, candidate.tail)


def choose(judged: dict[str, Judgement], share: Array) -> tuple[Candidate, list[Candidate]]:
    """The lobes of the fabric, which are of one kind, and what each region has of them: these or none.

    A byte a texel has to gain `DB_A_BYTE`.
    """

    def worth(candidate: Candidate, share: Array) -> float:
        return judged[candidate.name].psnr(share) - DB_A_BYTE * candidate.size

    plain, *lobed = CANDIDATES
    best = max(lobed, key=lambda candidate: worth(candidate, share))
    regions = np.eye(len(share))
    return best, [max((plain, best), key=lambda candidate: worth(candidate, only)) for only in regions]


def add_lobes(parser: argparse.ArgumentParser) -> None:
    """Arguments that say what lobes the slope model has."""
    parser.add_argument("--lobes", type=int, choices=(1, 2), default=1, help="lobes of the slope model")
    parser.add_argument("--tail", choices=tuple(TAILS), default="ggx", help="tail of the slope model's lobes")
    parser.add_argument("--choice", type=Path, help="instead of both: what `kinran choice` chose (.json)")


def take_choice(args: argparse.Namespace) -> list[int] | None:
    """Set the arguments of `add_lobes` to what was chosen; labels that get a lobe by it, None for all.

    Raises
    ------
    InputError
        The file is missing or is something else.
    """
    if not args.choice:
        return None
    value = read_json(args.choice)
    try:
        args.lobes, args.tail = int(value["lobes"]), str(value["tail"])
        return [int(label) for label in value["fitted"]]
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{args.choice}: holds no choice ({error!r}); make it with kinran choice") from None
