"""Add a residual to a fitted material where cross-validation over lights says that it pays."""

import logging
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import read_json, write_json
from kinran.base.log import progress
from kinran.data import material_prediction, metrics
from kinran.data.fabric import Fabric
from kinran.data.radiance_stack import Box
from kinran.fit import slope
from kinran.fit.components import by_light, leading, principal, remainder
from kinran.fit.cross_validation import deal, surrounded
from kinran.fit.light_splines import plates
from kinran.fit.region_priors import Prior, Priors
from kinran.fit.samples import Samples, read_samples, read_some, training_lights
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.material import Material, read_material, write_material
from kinran_bsdf.residual import Residual, compress, kernel_matrix

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Values = NDArray[np.float32]

FOLDS, FEW_FOLDS, MANY_LIGHTS = 8, 4, 256
"""Folds of the lights, fewer where there are more than `MANY_LIGHTS`, so that a choice takes seconds. A choice."""
SAMPLE = 1024
"""Texels on which the candidates are compared. A choice; no command compares other numbers."""
BASIS = 64
"""Most tiles that the components are found from: 262,144 texels, for some hundred lights. A choice."""
LEAST_GAIN_DB = 0.2
"""Gain in cross-validated PSNR, dB, that a residual needs to be worth its bytes. A choice: a light that is left out is
a whole step of the dome from the others, any other direction half of one, where the gain is up to twice as large
(`kinran bench objects`)."""
EXACT_DB = 80.0
"""PSNR, dB, from which a prediction is exact, and no residual worth its bytes: a ten-thousandth of white, about what
the stack's float16 rounds there."""
SURE = 2.0
"""Standard errors, over pairs of lights, from which a gain counts as sure: about one chance in forty. A choice."""
COMPONENTS = (4, 9, 16, 25)
"""Numbers of principal components that are tried: those of hemispherical harmonics of two to five orders. Choices."""
SMOOTHING = (1e-3, 1e-2, 3e-2, None)
"""Smoothing of thin plates that is tried; None takes harmonics instead. Choices."""
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)
"""Shares of the lobes in a picture that are tried; 0 leaves everything to the residual. Choices."""
BANDS = (0, 25, 45, 65, 90)
"""Bounds of the bands of θ, in degrees, by which a summary tells what was promised. A choice."""

Key = tuple[float, int, float | None]
"""Share of the lobes, number of components, smoothing."""
ALONE: Key = (1.0, 0, 0.0)
"""The lobes without a residual."""


@dataclass(frozen=True)
class Choice:
    """Residual that cross-validation chose, and its PSNR in dB, also by θ; 0 components are the lobes alone."""

    share: float
    components: int
    smoothing: float | None
    psnr: float
    lobes_psnr: float
    by_theta: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    prior: Annotated[Path, "priors of the regions (.json)"]
    material: Annotated[Path, "slope material (.exr)"]
    fitted: Annotated[Path, "summary of its fit (.json)"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    material: Annotated[Path, "OUT", "material with the residual (.exr)"]
    summary: Annotated[Path, "choice and cost (.json)"]


@dataclass(frozen=True)
class Options:
    """Options of the run."""

    threads: Annotated[int, "threads of this machine"] = 1


def main(inputs: Inputs, out: Outputs, options: Options = Options()) -> None:
    """Choose the residual on a sample of texels, then make its maps tile by tile."""
    start = time.process_time()
    fabric = Fabric(inputs.fabric)
    material = read_material(inputs.material)
    domain = fabric.stack.encoding or f"log:{_peak(fabric):.6g}"
    sample = read_some(fabric, _spread(fabric.stack.inside))
    lobes, priors = Lobes(material.tail, material.lobes), Priors.read(inputs.prior, fabric)
    choice = cross_validate(sample, lobes, priors.regions, domain, options.threads)
    if choice.components:
        material = _Left(fabric, material, domain, choice).material()
    write_material(out.material, material)
    seconds = time.process_time() - start
    write_json(out.summary, _summary(read_json(inputs.fitted), choice, seconds))
    log.info(
        "residual: %d components, share %g, cross-validated %.2f dB (lobes alone %.2f dB)",
        choice.components,
        choice.share,
        choice.psnr,
        choice.lobes_psnr,
    )


def _summary(fitted: dict[str, Any], choice: Choice, seconds: float) -> dict[str, Any]:
    """Summary of a fit with its residual, and the cost of both."""
    seconds += fitted["cpu_seconds"]
    peak = max(fitted["peak_mb"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    return {
        **fitted,
        "model": "slope with residual" if choice.components else "slope (a residual does not pay)",
        "cpu_seconds": round(seconds, 3),
        "microseconds_per_texel": round(1e6 * seconds / fitted["texels"], 2),
        "peak_mb": round(peak),
        "bytes_per_texel": fitted["bytes_per_texel"] + (6 * (choice.components + 1) if choice.components else 0),
        "residual": {
            "share_of_lobes": choice.share,
            "components": choice.components,
            "smoothing": choice.smoothing,
            "cross_validated_psnr": round(choice.psnr, 3),
            "by_theta": choice.by_theta,
            "of_the_lobes_alone": round(choice.lobes_psnr, 3),
        },
    }


def _peak(fabric: Fabric) -> float:
    """Largest 99.9th percentile of the training radiance in a sample of tiles."""
    boxes = fabric.stack.tiles()[:: max(1, len(fabric.stack.tiles()) // 16)]
    tiles = (read_samples(fabric, box) for box in boxes)
    return max(float(np.percentile(tile.under.reaching(tile.T), 99.9)) for tile in tiles)


def _spread(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mask (y, x) of the texels on which the candidates are compared, of those inside a mask."""
    chosen, texels = np.zeros(inside.size, bool), np.flatnonzero(inside)
    chosen[texels[np.linspace(0, len(texels) - 1, min(SAMPLE, len(texels))).astype(int)]] = True
    return chosen.reshape(inside.shape)


def cross_validate(samples: Samples, lobes: Lobes, priors: list[Prior], domain: str, threads: int = 1) -> Choice:
    """Choose share, components and smoothing of a residual by cross-validation over lights: see `pick`.

    Lobes are fitted anew in each fold. Lights outside the hull of the fitted ones do not count: to predict them is
    extrapolation, which punishes what is right inside.

    Parameters
    ----------
    priors
        A prior for each region.
    domain
        Name that `kinran_bsdf.residual.Residual` has for the display-like values.
    """
    samples = samples.unshared()
    under, lights = samples.under, samples.under.directions
    shown = by_light(under.reaching(samples.T), domain)
    usable = np.repeat((samples.W > 0).T, 3, axis=1).astype(np.float32)
    fold = deal(lights, FOLDS if len(lights) <= MANY_LIGHTS else FEW_FOLDS)
    inner = np.zeros(len(lights), bool)
    scores: dict[Key, Array] = {}
    for k in range(fold.max() + 1):
        train, test = fold != k, fold == k
        fitted = slope.fit(samples.only(train), lobes, priors, threads)
        said = by_light(under.reaching(fitted.predict(under)), domain)
        inner[test] = surrounded(lights[test], lights[train])
        for key, predicted in _candidates(shown, said, lights, domain, train, test):
            errors = [_psnr(p, g, u) for p, g, u in zip(predicted, shown[test], usable[test], strict=True)]
            scores.setdefault(key, np.zeros(len(lights)))[test] = errors
    counted = inner if inner.sum() > len(lights) / 4 else np.ones(len(lights), bool)
    choice = pick({key: values[counted] for key, values in scores.items()})
    chosen = scores[choice.share, choice.components, choice.smoothing]
    return replace(choice, by_theta=by_theta(chosen[counted], lights[counted]))


def by_theta(values: Array, lights: Array) -> dict[str, float]:
    """Means of values (light,) in each band of θ, in degrees, that has some of the lights (light, 3)."""
    theta = np.degrees(np.arccos(np.clip(lights[:, 2], -1, 1)))
    bands = [(f"{a} to {b}", (theta >= a) & (theta < b)) for a, b in pairwise(BANDS)]
    return {name: round(float(values[inside].mean()), 2) for name, inside in bands if inside.any()}


def pick(scores: dict[Key, Array]) -> Choice:
    """Choose the residual with the largest share of the lobes among those that pay and that none surely beats.

    One candidate surely beats another by `SURE` standard errors of pairs of lights; a few lights decide (after the rule
    of one standard error [Breiman1984]). A candidate pays if it surely beats the lobes alone, and by `LEAST_GAIN_DB` at
    least. Where none pays, the lobes stay alone.

    Parameters
    ----------
    scores
        PSNR (light,) in dB of each light left out, by candidate; `ALONE` is among them.
    """
    means = {key: float(values.mean()) for key, values in scores.items()}

    def better(one: Key, other: Key) -> bool:
        gain = scores[one] - scores[other]
        return bool(gain.mean() > SURE * gain.std() / np.sqrt(max(len(gain) - 1, 1)))

    pays = [key for key in means if means[key] >= means[ALONE] + LEAST_GAIN_DB and better(key, ALONE)]
    order = sorted(pays, key=lambda key: -means[key])
    shares = sorted({key[0] for key in pays}, reverse=True)
    best_of = [next(key for key in order if key[0] == share) for share in shares]
    chosen = next((key for key in best_of if not better(order[0], key)), ALONE)
    return Choice(*chosen, psnr=means[chosen], lobes_psnr=means[ALONE])


def _candidates(
    shown: Values, lobes: Values, lights: Array, domain: str, train: NDArray[np.bool_], test: NDArray[np.bool_]
) -> Iterator[tuple[Key, Values]]:
    """Predictions (test light, value) of the lobes alone and of every kind of residual."""
    yield ALONE, lobes[test]
    steps = {}
    for smoothing in SMOOTHING:
        nodes, weights = plates(lights[train], np.eye(train.sum()), smoothing)
        steps[smoothing] = kernel_matrix(lights[test, :2], nodes) @ weights
    for share in SHARES:
        left = remainder(shown[train], lobes[train], domain, share)
        mean = left.mean(0)
        basis = principal(left - mean, max(COMPONENTS))
        components = (basis.T @ (left - mean)).astype(np.float32)
        known = np.float32(share) * lobes[test] + mean
        for smoothing, step in steps.items():
            factors = (step @ basis).astype(np.float32)
            for count in COMPONENTS:
                if count < train.sum():
                    yield (share, count, smoothing), known + factors[:, :count] @ components[:count]


def _psnr(predicted: Values, truth: Values, usable: Values) -> float:
    return min(EXACT_DB, metrics.psnr(np.clip(predicted, 0, 1), np.clip(truth, 0, 1), usable))


def _some(boxes: list[Box]) -> list[Box]:
    """Return all boxes, or `BASIS` of them that lie evenly and in no row or column of the fabric alone."""
    golden = np.arange(BASIS) * (np.sqrt(5) - 1) / 2 % 1
    return boxes if len(boxes) <= BASIS else [boxes[k] for k in np.unique((golden * len(boxes)).astype(int))]


@dataclass(frozen=True)
class _Left:
    """The remainder that the lobes of a fabric's material leave, and the maps of its residual."""

    fabric: Fabric
    lobes: Material
    domain: str
    choice: Choice

    def tile(self, box: Box) -> Values:
        """Remainder (light, texel · 3) of one tile."""
        lights = training_lights(self.fabric.stack)
        tile = read_samples(self.fabric, box)
        said = material_prediction.predict(self.lobes, self.fabric.stack, box, lights).reshape(len(lights), -1)
        shown = by_light(np.nan_to_num(tile.under.reaching(tile.T)), self.domain)
        return remainder(shown, compress(said, self.domain), self.domain, self.choice.share)

    def components(self) -> Array:
        """Factors (light, count) of the components, from the Gram matrix of tiles all over the fabric."""
        count = len(training_lights(self.fabric.stack))
        gram = np.zeros((count, count))
        for box in _some(self.fabric.stack.tiles()):
            left = self.tile(box)
            left = left - left.mean(0)
            gram += left @ left.T
        return leading(gram, self.choice.components)

    def maps(self, basis: Array) -> NDArray[np.float16]:
        """Mean and components (count + 1, 3, y, x), in the precision of a material's file."""
        stack = self.fabric.stack
        maps = np.zeros((basis.shape[1] + 1, 3, stack.height, stack.width), np.float16)
        for box in progress(stack.tiles(), "residual", "tiles"):
            y0, y1, x0, x1 = box
            left = self.tile(box)
            mean = left.mean(0)
            whole = np.concatenate([mean[None], basis.T @ (left - mean)])
            maps[..., y0:y1, x0:x1] = whole.reshape(-1, y1 - y0, x1 - x0, 3).transpose(0, 3, 1, 2)
        return maps

    def material(self) -> Material:
        """The material with its residual."""
        basis = self.components()
        channels = dict(self.lobes.channels)
        for k, plane in enumerate(self.maps(basis)):
            channels.update({f"residual{k}.{c}": plane[i] for i, c in enumerate("RGB")})
        lights = self.fabric.stack.directions[training_lights(self.fabric.stack)]
        splines = plates(lights, basis, self.choice.smoothing)
        return replace(self.lobes, channels=channels, residual=Residual(self.domain, self.choice.share, *splines))
