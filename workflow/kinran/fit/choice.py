"""Choose the simplest lobes that explain a fabric, by error under lights left out with a stated cost a byte.

Regions are chosen for by cross-validation, and so is the fabric, whose lobes are of one kind. What each texel would
need by itself is a map for people: `kinran material` takes the regions' choice.
"""

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import pictures
from kinran.files import write_json
from kinran.fit import samples, simplest
from kinran.fit.candidates import CANDIDATES, DB_A_BYTE, Candidate, Sampled, display, fitted
from kinran.fit.sampled import of_regions
from kinran.labels import LabelMap, read_labels, read_regions, read_second
from kinran.stack import Stack

Array = NDArray[np.float64]
SAMPLE = 256
"""Texels of a region that the choice is made on."""
FOLDS, FEW_FOLDS, MANY_LIGHTS = 10, 4, 256
MOST_DB = 60.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    parser.add_argument("--picture", type=Path, required=True, help="what each texel needs, for people (.png)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="what was chosen, and why (.json)")


def main(args: argparse.Namespace) -> None:
    """Judge the candidates on a sample of each region, choose, and write both; then map what each texel needs."""
    stack = Stack.open(args.stack)
    names = [region.name for region in read_regions(args.regions)]
    labels, second = read_labels(args.labels), read_second(args.labels)
    sample = sampled(stack, labels, second, len(names))
    share = np.bincount(labels.ravel(), minlength=len(names)) / labels.size
    judged = judge(sample, args.threads)
    chosen, kinds = choose(judged, share)
    bytes_needed = float(share @ [kind.size for kind in kinds])
    needs = simplest.texel_map(stack, labels, second, sample, judged[chosen.name].error(share), args.threads)
    sizes = np.array([candidate.size for candidate in CANDIDATES])
    write_json(
        args.out,
        {
            "tail": chosen.tail,
            "lobes": chosen.lobes,
            "fitted": [k for k, kind in enumerate(kinds) if kind.lobes],
            "decibels_a_byte": DB_A_BYTE,
            "bytes_per_texel": round(bytes_needed, 1),
            "bytes_saved": round(max(CANDIDATES[-1].size - bytes_needed, 0.0), 1),
            "bytes_of_texels_alone": round(float(sizes[needs].mean()), 1),
            "regions": {
                name: {
                    "chosen": kind.name,
                    **{c.name: judged[c.name].row(k) | _share(needs, labels == k, i) for i, c in enumerate(CANDIDATES)},
                }
                for k, (name, kind) in enumerate(zip(names, kinds, strict=True))
            },
        },
    )
    pictures.write_png(args.picture, simplest.picture(needs))
    print(f"choice: {', '.join(f'{n}: {kind.name}' for n, kind in zip(names, kinds, strict=True))}", file=sys.stderr)


def sampled(stack: Stack, labels: LabelMap, second: LabelMap, count: int) -> Sampled:
    """Texels of each of `count` regions that the choice is made on."""
    T, W, at = of_regions(stack, labels, count, SAMPLE)
    region, shares = (m.reshape(-1)[at].astype(np.intp) for m in (labels, second))
    return Sampled(T, W, samples.training_directions(stack), region, shares, display(stack, T))


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

    def error(self, share: Array) -> float:
        """Mean squared error of regions that have these shares of the fabric."""
        return float((self.square @ (share / share.sum())).mean())

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


def judge(sample: Sampled, threads: int) -> dict[str, Judgement]:
    """Cross-validate the candidates; priors are learnt anew in each fold, from its lights alone."""
    T, W = sample.T, sample.W
    n = len(sample.lights)
    one_of = np.eye(int(sample.region.max()) + 1)[sample.region]
    usable = sample.usable()
    fold = np.random.default_rng(0).permutation(n) % (FOLDS if n <= MANY_LIGHTS else FEW_FOLDS)
    result = {}
    for candidate in CANDIDATES:
        predicted = np.empty_like(T)
        for k in range(fold.max() + 1):
            predicted[:, :, fold == k] = fitted(candidate, sample.under(fold != k), sample.lights[fold == k], threads)
        off = usable * (sample.shown(predicted) - sample.shown(T)) ** 2
        square = np.einsum("tcl,tr->lr", off, one_of) / np.maximum(np.einsum("tcl,tr->lr", usable, one_of), 1)
        error, energy = (usable * (predicted - T) ** 2).sum((1, 2)), (usable * T**2).sum((1, 2))
        relative = np.sqrt((error @ one_of) / np.maximum(energy @ one_of, 1e-30))
        left = fitted(candidate, sample, sample.lights, threads) - T
        size = np.maximum(usable.sum((1, 2)), 1)
        fit = size * np.log(np.maximum((W[:, None] * usable * left**2).sum((1, 2)), 1e-30) / size)
        texels = np.maximum(one_of.sum(0), 1)
        bic, aic = (fit + candidate.numbers * weight for weight in (np.log(size), 2.0))
        result[candidate.name] = Judgement(square, relative, bic @ one_of / texels, aic @ one_of / texels)
    return result


def choose(judged: dict[str, Judgement], share: Array, cost: float = DB_A_BYTE) -> tuple[Candidate, list[Candidate]]:
    """The lobes of the fabric, which are of one kind, and what each region has of them: these or none.

    A byte a texel has to gain `cost` decibels.
    """

    def worth(candidate: Candidate, share: Array) -> float:
        return judged[candidate.name].psnr(share) - cost * candidate.size

    plain, *lobed = CANDIDATES
    best = max(lobed, key=lambda candidate: worth(candidate, share))
    regions = np.eye(len(share))
    return best, [max((plain, best), key=lambda candidate: worth(candidate, only)) for only in regions]


def _share(needs: NDArray[np.uint8], inside: NDArray[np.bool_], candidate: int) -> dict[str, float]:
    """Share of a region's texels that need this candidate."""
    return {"texels": round(float((needs[inside] == candidate).mean()), 4) if inside.any() else 0.0}
