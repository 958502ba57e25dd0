"""How many labels are right: regions by Mahalanobis distance beside k-means and EM, on a fabric whose truth is known.

The truth is the geometry of the virtual fabric. All methods see the same statistics over the training lights and the
same number of regions; a region that is found counts as the thread that most of its texels are.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.baselines import mixture
from kinran.chart import rows
from kinran.chart.rows import Row
from kinran.files import InputError, check_name
from kinran.labels import read_labels
from kinran.segment import mahalanobis
from kinran.segment.appearance import over_lights
from kinran.stack import Stack
from kinran.virtual.weave import VirtualFabric

Labels = NDArray[np.intp]

PURE = 0.9
"""Texels of which one thread fills more than this share are pure."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--fabric", required=True)
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr) of the virtual rig")
    parser.add_argument("--labels", type=Path, required=True, help="label map (.exr)")
    parser.add_argument("--scene", required=True, help="the virtual fabric, as JSON")
    parser.add_argument("out", type=Path, help="table (.csv)")


def main(args: argparse.Namespace) -> None:
    """Write the table."""
    stack, found = Stack.open(args.stack), read_labels(args.labels)
    truth, purity = VirtualFabric(**json.loads(args.scene)).labels()
    if truth.shape != found.shape:
        raise InputError(f"{args.labels}: its size is not that of the virtual fabric; make it again")
    features = over_lights(stack).features()
    count = int(found.max()) + 1
    clusters = mahalanobis.kmeans(features, count)
    compared = {
        ("Mahalanobis", "kinran"): found.reshape(-1).astype(np.intp),
        ("k-means", "baseline"): clusters,
        ("EM", "baseline"): mixture.labels(features, clusters, count),
    }
    fabric, lights = check_name(args.fabric, "fabric"), int((~stack.held_out).sum())
    table = []
    for (method, family), labels in compared.items():
        shares = right(labels, truth.reshape(-1).astype(np.intp), purity.reshape(-1) > PURE)
        print(f"{method}: " + ", ".join(f"{100 * v:.2f} % of {k}" for k, v in shares.items()), file=sys.stderr)
        for setting, share in shares.items():
            table.append(Row(fabric, "segmentation", setting, method, family, lights, {"accuracy": share}))
    rows.write(args.out, table)


def right(labels: Labels, truth: Labels, pure: NDArray[np.bool_]) -> dict[str, float]:
    """Share of right labels (texel,) among all texels and among the pure ones."""
    named = np.zeros(int(labels.max()) + 1, np.intp)
    for k in np.unique(labels):
        named[k] = np.bincount(truth[labels == k]).argmax()
    hit = named[labels] == truth
    return {"all texels": float(hit.mean()), "pure texels": float(hit[pure].mean())}
