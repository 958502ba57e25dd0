"""Add a residual to a fitted material where cross-validation over lights says that it pays."""

import argparse
import resource
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran import metrics, prediction
from kinran.files import read_json, write_json
from kinran.fit import samples, slope
from kinran.fit.folds import deal, surrounded
from kinran.fit.plates import plates
from kinran.fit.predict import predict
from kinran.labels import LabelMap, read_labels
from kinran.stack import Stack
from kinran_bsdf.material import Material, read_material, write_material
from kinran_bsdf.residual import Residual, compress, kernel_matrix

Array = NDArray[np.float64]
Values = NDArray[np.float32]

FOLDS, FEW_FOLDS, MANY_LIGHTS = 8, 4, 256
SAMPLE = 1024
"""Texels that the choice is made on."""
LEAST_GAIN_DB = 0.3
"""What a residual has to gain in cross-validation to be worth its bytes."""
SURE = 2.0
COMPONENTS = (4, 9, 16)
SMOOTHING = (1e-3, 1e-2, 3e-2, None)
"""Of thin plates; None are harmonics."""
SHARES = (1.0, 0.75, 0.5, 0.25, 0.0)

Key = tuple[float, int, float | None]
"""Share of the lobes, components, smoothing."""
ALONE: Key = (1.0, 0, 0.0)


@dataclass(frozen=True)
class Choice:
    """What cross-validation chose: 0 components are the lobes alone."""

    share: float
    components: int
    smoothing: float | None
    psnr: float
    lobes_psnr: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--prior", type=Path, required=True, help="priors of the regions (.json)")
    parser.add_argument("--material", type=Path, required=True, help="slope material (.exr)")
    parser.add_argument("--fitted", type=Path, required=True, help="summary of its fit (.json)")
    parser.add_argument("--summary", type=Path, required=True, help="choice and cost (.json)")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="material with the residual (.exr)")


def main(args: argparse.Namespace) -> None:
    """Choose on a sample of texels, then make the maps tile by tile."""
    start = time.process_time()
    stack = Stack.open(args.stack)
    material = read_material(args.material)
    lights = samples.training_directions(stack)
    domain = stack.encoding or f"log:{_peak(stack):.6g}"
    shape = material.tail, material.lobes
    choice = choose(stack, read_labels(args.labels), args.prior, domain, shape, args.threads)
    summary = read_json(args.fitted)
    if choice.components:
        basis = _components(stack, material, lights, domain, choice)
        maps = _maps(stack, material, lights, domain, choice.share, basis)
        channels = dict(material.channels)
        for k, plane in enumerate(maps):
            channels.update({f"residual{k}.{c}": np.ascontiguousarray(plane[..., i]) for i, c in enumerate("RGB")})
        residual = Residual(domain, choice.share, *plates(lights, basis, choice.smoothing))
        material = replace(material, channels=channels, residual=residual)
    write_material(args.out, material)
    seconds = summary["cpu_seconds"] + time.process_time() - start
    texels = summary["texels"]
    write_json(
        args.summary,
        {
            **summary,
            "model": "slope with residual" if choice.components else "slope (a residual does not pay)",
            "cpu_seconds": round(seconds, 3),
            "microseconds_per_texel": round(1e6 * seconds / texels, 2),
            "peak_mb": round(max(summary["peak_mb"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)),
            "bytes_per_texel": summary["bytes_per_texel"] + (6 * (choice.components + 1) if choice.components else 0),
            "residual": {
                "share_of_lobes": choice.share,
                "components": choice.components,
                "smoothing": choice.smoothing,
                "cross_validated_psnr": round(choice.psnr, 3),
                "of_the_lobes_alone": round(choice.lobes_psnr, 3),
            },
        },
    )
    print(
        f"residual: {choice.components} components, share {choice.share:g}, cross-validated {choice.psnr:.2f} dB"
        f" (lobes alone {choice.lobes_psnr:.2f} dB)",
        file=sys.stderr,
    )


def _peak(stack: Stack) -> float:
    """99.9th percentile of the training radiance, of a sample of tiles."""
    boxes = stack.tiles()
    return max(float(np.percentile(samples.read(stack, box).T, 99.9)) for box in boxes[:: max(1, len(boxes) // 16)])


def choose(stack: Stack, labels: LabelMap, prior: Path, domain: str, shape: tuple[str, int], threads: int) -> Choice:
    """Share, components and smoothing, by a sample of the texels under the training lights."""
    T, W, region = _sample(stack, labels)
    lights = samples.training_directions(stack)
    return cross_validate(T, W, lights, slope.read_priors(prior), region, domain, shape, threads)


def cross_validate(
    T: Values,
    W: Values,
    lights: Array,
    priors: list[slope.Prior],
    region: NDArray[np.intp],
    domain: str,
    shape: tuple[str, int],
    threads: int = 1,
) -> Choice:
    """Share, components and smoothing by lights left out: see `pick`.

    Lobes of `shape` (tail and number) are fitted anew in each fold. Lights that are outside of those they are predicted
    from do not count: that is extrapolation, which punishes what is right inside.

    Parameters
    ----------
    T : (texel, 3, light) float32
    W : (texel, light) float32
    lights : (light, 3) float
    priors, region
        As of `slope.fit`.
    domain
        As of `kinran_bsdf.residual.Residual`.
    """
    shown = compress(T, domain).transpose(2, 0, 1).reshape(len(lights), -1)
    usable = np.repeat((W > 0).T, 3, axis=1).astype(np.float32)
    fold = deal(lights, FOLDS if len(lights) <= MANY_LIGHTS else FEW_FOLDS)
    inner = np.zeros(len(lights), bool)
    scores: dict[Key, Array] = {}
    for k in range(fold.max() + 1):
        train, test = fold != k, fold == k
        part = np.ascontiguousarray(T[..., train]), np.ascontiguousarray(W[:, train])
        fitted = slope.fit(*part, lights[train], *shape, priors=priors, region=region, threads=threads)
        lobes = compress(predict(fitted, lights, shape[0]), domain).transpose(2, 0, 1).reshape(len(lights), -1)
        inner[test] = surrounded(lights[test], lights[train])
        for key, predicted in _candidates(shown, lobes, lights, domain, train, test):
            errors = [_psnr(p, g, u) for p, g, u in zip(predicted, shown[test], usable[test], strict=True)]
            scores.setdefault(key, np.zeros(len(lights)))[test] = errors
    counted = inner if inner.sum() > len(lights) / 4 else np.ones(len(lights), bool)
    return pick({key: values[counted] for key, values in scores.items()})


def pick(scores: dict[Key, Array]) -> Choice:
    """Of the candidates that pay, that with the largest share of the lobes than which none is surely better.

    Surely: by `SURE` standard errors of pairs of lights, since few decide [after the rule of one standard error,
    Breiman1984]. A candidate pays that surely gains, and at least `LEAST_GAIN_DB`; where none does, the lobes alone.

    Parameters
    ----------
    scores
        PSNR (light,) of each light left out, by candidate; among them `ALONE`.
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


def _sample(stack: Stack, labels: LabelMap) -> tuple[Values, Values, NDArray[np.intp]]:
    flat = np.zeros(labels.size, np.uint16)
    flat[np.linspace(0, labels.size - 1, min(SAMPLE, labels.size)).astype(int)] = 1
    chosen = flat.reshape(labels.shape)
    T, W, region = [], [], []
    for tile in samples.iterate(stack, stack.tiles()):
        inside = samples.cut(chosen, tile.box) > 0
        T.append(tile.T[inside])
        W.append(tile.W[inside])
        region.append(samples.cut(labels, tile.box)[inside])
    return np.concatenate(T), np.concatenate(W), np.concatenate(region)


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


def remainder(shown: Values, lobes: Values, domain: str, share: float) -> Values:
    """What the lobes leave; nothing where a photograph is saturated and the lobes are over it."""
    left = shown - np.float32(share) * lobes
    photograph = not domain.startswith("log:")
    return np.where((shown >= 1) & (left < 0), 0, left) if share == 1 and photograph else left


def principal(left: Values, count: int) -> Array:
    """Orthonormal factors (light, ≤ count) of the first principal components over lights."""
    values, vectors = np.linalg.eigh((left @ left.T).astype(float))
    return np.asarray(vectors[:, np.argsort(values)[::-1][:count]])


def _psnr(predicted: Values, truth: Values, usable: Values) -> float:
    return metrics.psnr(np.clip(predicted, 0, 1), np.clip(truth, 0, 1), usable)


def _tile(stack: Stack, material: Material, lights: Array, domain: str, share: float, box: samples.Box) -> Values:
    """Remainder (light, texel · 3) of one tile."""
    tile = samples.read(stack, box)
    lobes = prediction.predict(material, stack, box, samples.training_lights(stack))
    shown = compress(np.nan_to_num(tile.T), domain).transpose(2, 0, 1).reshape(len(lights), -1)
    return remainder(shown, compress(lobes.reshape(len(lights), -1), domain), domain, share)


def _components(stack: Stack, material: Material, lights: Array, domain: str, choice: Choice) -> Array:
    """Factors (light, count) of the components, from the Gram matrix of all tiles."""
    gram = np.zeros((len(lights), len(lights)))
    for box in stack.tiles():
        left = _tile(stack, material, lights, domain, choice.share, box)
        left = left - left.mean(0)
        gram += left @ left.T
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, np.argsort(values)[::-1][: choice.components]])


def _maps(stack: Stack, material: Material, lights: Array, domain: str, share: float, basis: Array) -> Values:
    """Mean and components (count + 1, y, x, 3)."""
    maps = np.zeros((basis.shape[1] + 1, stack.height, stack.width, 3), np.float32)
    for y0, y1, x0, x1 in stack.tiles():
        left = _tile(stack, material, lights, domain, share, (y0, y1, x0, x1))
        mean = left.mean(0)
        shape = (y1 - y0, x1 - x0, 3)
        maps[0, y0:y1, x0:x1] = mean.reshape(shape)
        maps[1:, y0:y1, x0:x1] = (basis.T @ (left - mean)).reshape(-1, *shape)
        print(f"residual: tile {y0},{x0}", file=sys.stderr, flush=True)
    return maps
