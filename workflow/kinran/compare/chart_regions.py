"""Chart the share of right labels of Mahalanobis distance, k-means and EM, on a fabric whose truth is known.

The truth is the geometry of the virtual fabric. All methods see the same statistics over the training lights and the
same number of regions; a region counts as the thread of most of its texels.
"""

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, check_name
from kinran.compare import rows
from kinran.compare.baselines import mixture
from kinran.compare.rows import Row
from kinran.data.fabric import Fabric
from kinran.segment import mahalanobis
from kinran.segment.appearance import over_lights
from kinran.virtual.weave import VirtualFabric

log = logging.getLogger(__name__)

Labels = NDArray[np.intp]

PURE = 0.9
"""Share that one thread has to exceed for a texel to be pure. A choice: an edge within a texel's tenth is left."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric, of the virtual rig: radiance.zarr, labels.exr"]


@dataclass(frozen=True)
class Options:
    """Name and geometry of the fabric."""

    name: Annotated[str, "name of the fabric"]
    scene: Annotated[str, "the virtual fabric, as JSON"]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "table (.csv)"], options: Options) -> None:
    """Write the table."""
    name, fabric = check_name(options.name, "fabric"), Fabric(inputs.fabric)
    truth, purity = VirtualFabric(**json.loads(options.scene)).labels()
    if truth.shape != fabric.labels.shape:
        raise InputError(f"{fabric.labels_path}: its size is not that of the virtual fabric; make it again")
    found = fabric.labels.reshape(-1).astype(np.intp)
    features = over_lights(fabric.stack).features()
    count = int(found.max()) + 1
    clusters = mahalanobis.kmeans(features, count)
    compared = {
        ("Mahalanobis", "kinran"): found,
        ("k-means", "baseline"): clusters,
        ("EM", "baseline"): mixture.labels(features, clusters, count),
    }
    lights = int((~fabric.stack.held_out).sum())
    table = []
    for (method, family), labels in compared.items():
        shares = right(labels, truth.reshape(-1).astype(np.intp), purity.reshape(-1) > PURE)
        log.info("%s: %s", method, ", ".join(f"{100 * share:.2f} % of {part}" for part, share in shares.items()))
        for setting, share in shares.items():
            table.append(Row(name, "segmentation", setting, method, family, lights, {"accuracy": share}))
    rows.write(out, table)


def right(labels: Labels, truth: Labels, pure: NDArray[np.bool_]) -> dict[str, float]:
    """Share of right labels (texel,) among all texels, and among the pure ones (texel,)."""
    named = np.zeros(int(labels.max()) + 1, np.intp)
    for k in np.unique(labels):
        named[k] = np.bincount(truth[labels == k]).argmax()
    hit = named[labels] == truth
    return {"all texels": float(hit.mean()), "pure texels": float(hit[pure].mean())}
