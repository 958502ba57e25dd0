"""Prior of each region on the shapes of its lobes, from free fits of a sample of its texels."""

import argparse
from pathlib import Path

import numpy as np

from kinran.files import write_json
from kinran.fit import samples, slope
from kinran.fit.tile import add_lobes
from kinran.labels import read_labels, read_regions
from kinran.stack import Stack

SAMPLE = 512
"""Texels of a region that its prior is made of."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--regions", type=Path, required=True, help="regions (.json)")
    add_lobes(parser)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("out", type=Path, help="priors (.json)")


def main(args: argparse.Namespace) -> None:
    """Fit a sample of each region freely and write what they share."""
    stack = Stack.open(args.stack)
    labels = read_labels(args.labels)
    count = len(read_regions(args.regions))
    chosen = np.zeros(labels.size, bool)
    for k in range(count):
        inside = np.flatnonzero(labels.reshape(-1) == k)
        chosen[inside[np.linspace(0, len(inside) - 1, min(SAMPLE, len(inside))).astype(int)]] = True
    chosen_map = chosen.reshape(labels.shape)
    T, W, region = [], [], []
    for tile in samples.iterate(stack, stack.tiles()):
        y0, y1, x0, x1 = tile.box
        inside = chosen_map[y0:y1, x0:x1].reshape(-1)
        T.append(tile.T[inside])
        W.append(tile.W[inside])
        region.append(samples.cut(labels, tile.box)[inside])
    priors = slope.learn_priors(
        np.concatenate(T),
        np.concatenate(W),
        samples.training_directions(stack),
        np.concatenate(region),
        count,
        args.tail,
        args.lobes,
        args.threads,
    )
    write_json(args.out, [{"centre": p.centre.tolist(), "variance": p.variance} for p in priors])
