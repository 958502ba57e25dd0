"""Prior of each region on the shapes of its lobes, from free fits of a sample of its texels."""

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from kinran.fit import learned, reweighted, samples, slope, strength, trust
from kinran.fit.chosen import add_lobes, take_choice
from kinran.fit.sampled import of_regions
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
    take_choice(args)
    stack = Stack.open(args.stack)
    count = len(read_regions(args.regions))
    labels = read_labels(args.labels)
    T, W, at = of_regions(stack, labels, count, SAMPLE)
    region = labels.reshape(-1)[at].astype(np.intp)
    lights = samples.training_directions(stack)
    kind = args.tail, args.lobes, args.threads
    seen = [stack.lights[i] for i in samples.training_lights(stack)]
    trusted = trust.learn(T, W, lights, *kind)
    trust.say(trusted, seen)
    W = W * trusted.lights
    if trusted.outliers:
        fit = partial(slope.fit, lobes=args.lobes, threads=args.threads)
        W = reweighted.robust(T, W, lights, args.tail, fit)[1]
    priors = learned.learn_priors(T, W, lights, region, count, *kind)
    slope.write_priors(args.out, strength.weigh(priors, T, W, lights, region, *kind), trusted.row(seen))
