"""Choose the simplest lobes that explain a fabric, by cross-validation over lights with a stated cost per byte.

The choice is made for each region, and for the fabric, whose lobes are of one kind. The map of what each texel would
need by itself is for people: `kinran material` follows the choice of the regions.
"""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.base.files import write_json
from kinran.data.fabric import Fabric
from kinran.fit import texel_map
from kinran.fit.candidates import CANDIDATES, DB_A_BYTE, Candidate, Display, display
from kinran.fit.samples import Samples, read_some, spread_over_regions

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Single = NDArray[np.float32]

SAMPLE = 256
"""Texels of a region on which the candidates are compared. A choice; no command compares other numbers."""
FOLDS, FEW_FOLDS, MANY_LIGHTS = 10, 4, 256
"""Folds of the lights, fewer where there are more than `MANY_LIGHTS`, so that a choice takes seconds. A choice."""
MOST_DB = 60.0
"""PSNR in dB above which a region counts no better: no eye sees a difference, and noise would decide. A choice."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    choice: Annotated[Path, "OUT", "chosen lobes, and the errors that decided (.json)"]
    picture: Annotated[Path, "map of the lobes that each texel needs, for people (.png)"]


@dataclass(frozen=True)
class Options:
    """Options of the run."""

    threads: Annotated[int, "threads of this machine"] = 1


def main(inputs: Inputs, out: Outputs, options: Options = Options()) -> None:
    """Cross-validate the candidates on a sample of each region, and write the choice and the map of the texels."""
    fabric = Fabric(inputs.fabric)
    names = [region.name for region in fabric.regions]
    labels = fabric.labels
    sample = read_some(fabric, spread_over_regions(labels, len(names), SAMPLE, fabric.stack.inside))
    shown = display(fabric.stack, sample.T)
    of_inside = labels[fabric.stack.inside]
    share = np.bincount(of_inside, minlength=len(names)) / of_inside.size
    judged = judge(sample, shown, options.threads)
    chosen, kinds = choose(judged, share)
    assert chosen.lobes
    bytes_needed = float(share @ [kind.size for kind in kinds])
    needs = texel_map.texel_map(fabric, sample, shown, judged[chosen.name].error(share), options.threads)
    sizes = np.array([candidate.size for candidate in CANDIDATES])
    write_json(
        out.choice,
        {
            "tail": chosen.lobes.tail,
            "lobes": chosen.lobes.count,
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
    pictures.write_png(out.picture, texel_map.picture(needs))
    log.info("choice: %s", ", ".join(f"{n}: {kind.name}" for n, kind in zip(names, kinds, strict=True)))


@dataclass(frozen=True)
class Judgement:
    """Cross-validated errors of a candidate, by region.

    Attributes
    ----------
    square : (light, region)
        Mean squared error of displayed values under each training light while that was left out.
    relative : (region,)
        Relative error √(Σ (m - g)² / Σ g²) in linear light, over the lights left out.
    bic, aic : (region,)
        Schwarz's and Akaike's criteria n ln(RSS / n) + k ln n and n ln(RSS / n) + 2 k of the fit to all training
        lights, mean over the texels.
    """

    square: Array
    relative: Array
    bic: Array
    aic: Array

    def error(self, share: Array) -> float:
        """Mean squared error of a fabric in which the regions have these shares (region,)."""
        return float((self.square @ (share / share.sum())).mean())

    def psnr(self, share: Array) -> float:
        """Mean PSNR over the lights, in dB, of a fabric in which the regions have these shares (region,)."""
        error = self.square @ (share / share.sum())
        return float(np.mean(np.minimum(-10 * np.log10(np.maximum(error, 1e-12)), MOST_DB)))

    def row(self, region: int) -> dict[str, float]:
        """Figures of one region, for the JSON file."""
        only = np.eye(len(self.relative))[region]
        values = {"psnr": self.psnr(only), "relative_error": self.relative[region]}
        values |= {"bic": self.bic[region], "aic": self.aic[region]}
        return {name: float(f"{value:.5g}") for name, value in values.items()}


def judge(sample: Samples, shown: Display, threads: int) -> dict[str, Judgement]:
    """Cross-validate the candidates, by name; priors are learned anew in each fold, from its lights alone."""
    n = sample.under.count
    fold = np.random.default_rng(0).permutation(n) % (FOLDS if n <= MANY_LIGHTS else FEW_FOLDS)
    result = {}
    for candidate in CANDIDATES:
        left = np.empty_like(sample.T)
        for k in range(fold.max() + 1):
            train, test = sample.only(fold != k), sample.under.only(fold == k)
            left[:, :, fold == k] = candidate.predicted(train, candidate.priors(train, threads), test, threads)
        known = candidate.predicted(sample, candidate.priors(sample, threads), sample.under, threads)
        result[candidate.name] = _judgement(sample, shown, left, known, candidate.numbers)
    return result


def _judgement(sample: Samples, shown: Display, left: Single, known: Single, numbers: int) -> Judgement:
    """Errors of predictions (texel, 3, light): `left` where each light was left out, `known` where all were fitted."""
    T, W, usable = sample.T, sample.W, sample.usable()
    one_of = np.eye(int(sample.region.max()) + 1)[sample.region]
    off = usable * (shown(left) - shown(T)) ** 2
    square = np.einsum("tcl,tr->lr", off, one_of) / np.maximum(np.einsum("tcl,tr->lr", usable, one_of), 1)
    error, energy = (usable * (left - T) ** 2).sum((1, 2)), (usable * T**2).sum((1, 2))
    relative = np.sqrt((error @ one_of) / np.maximum(energy @ one_of, 1e-30))
    size = np.maximum(usable.sum((1, 2)), 1)
    misfit = size * np.log(np.maximum((W[:, None] * usable * (known - T) ** 2).sum((1, 2)), 1e-30) / size)
    texels = np.maximum(one_of.sum(0), 1)
    bic, aic = (misfit + numbers * weight for weight in (np.log(size), 2.0))
    return Judgement(square, relative, bic @ one_of / texels, aic @ one_of / texels)


def choose(judged: dict[str, Judgement], share: Array, cost: float = DB_A_BYTE) -> tuple[Candidate, list[Candidate]]:
    """Choose the lobes of the fabric, which are of one kind, and for each region either these or none.

    Parameters
    ----------
    judged
        Errors of each candidate, by its name.
    share : (region,)
        Share of each region in the texels of the fabric.
    cost
        Decibels that a byte per texel has to gain.
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
