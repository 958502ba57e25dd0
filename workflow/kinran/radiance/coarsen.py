"""Make the texels of a fabric as coarse as a scene allows, before any fit: model no more than is seen.

A camera sees the mean radiance of texels that are too small to be told apart. So the coarse stack is what the rig
would have measured with a wider lens, and every fit, error and cost that follows is that of its texels.
"""

import logging
import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.data.block_average import average, blocks
from kinran.data.fabric import Fabric
from kinran.data.labels import write_labels, write_regions
from kinran.data.needed_regions import read_need
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import CHUNK, Stack, write_metadata, write_shards
from kinran.data.shards import NAMES, SHARD, shard_path

Planes = NDArray[Any]

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    fabric: Annotated[Path, "folder of radiance stack, label map and regions"]
    need: Annotated[Path, "what the scene needs (.json)"]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "folder of the fabric with coarse texels"]) -> None:
    """Write stack, labels and regions of coarse texels."""
    fine, coarse = Fabric(inputs.fabric), Fabric(out)
    stack, factor = fine.stack, read_need(inputs.need).footprint.coarsest_factor
    if factor > min(stack.height, stack.width):
        raise InputError(
            f"{stack.path}: a texel that {inputs.need} allows, {factor} wide, is wider than it; move the camera closer"
        )
    labels = coarse_labels(read_exr(fine.labels_path), factor)
    write_labels(coarse.labels_path, **labels)
    counts = np.bincount(labels["labels"].reshape(-1)).tolist()
    rows = [replace(r, texels=counts[r.label] if r.label < len(counts) else 0) for r in fine.regions]
    write_regions(coarse.regions_path, rows)
    write_coarse(coarse.stack_path, stack, factor)
    height, width = labels["labels"].shape
    log.info("coarsen: %d x %d texels make one; %d x %d of them", factor, factor, width, height)


def coarse_labels(channels: dict[str, NDArray[np.float32]], factor: int) -> dict[str, Any]:
    """Return the regions of blocks of texels, by their share of the area.

    Parameters
    ----------
    channels
        Channels (y, x) of a label map: the membership is the share of a texel's label in it, the rest is the second's.
    factor
        Texels along the side of a block.

    Returns
    -------
    dict
        Arguments of `write_labels`.
    """
    label, second = (channels[name].astype(np.intp) for name in ("label", "second"))
    share = channels["membership"]
    count = int(max(label.max(), second.max())) + 1
    area = np.stack([share * (label == k) + (1 - share) * (second == k) for k in range(count)])
    area = np.asarray(blocks(area[..., None], factor).mean((2, 4))[..., 0])
    order = np.argsort(-area, axis=0, kind="stable")
    first, other = order[0], order[min(1, count - 1)]
    most, rest = (np.take_along_axis(area, which[None], 0)[0] for which in (first, other))
    shared = (rest > 0) & (other != first)
    return {
        "labels": first,
        "confidence": np.asarray(blocks(channels["confidence"][None, ..., None], factor).mean((2, 4))[0, ..., 0]),
        "second": np.where(shared, other, first),
        "membership": np.where(shared, most / (most + rest), 1).astype(np.float32),
    }


def write_coarse(path: Path, stack: Stack, factor: int) -> None:
    """Write the coarse stack, whose texels are averaged by `average`, one shard at a time."""
    if path.exists():
        shutil.rmtree(path)  # its shards may be of another size
    for first in range(0, len(stack.lights), SHARD):
        if factor == 1:
            _link(stack.path, path, first // SHARD)
        else:
            write_shards(path, first, _coarse_shard(stack, first, factor))
    coarse = replace(
        stack,
        height=stack.height // factor,
        width=stack.width // factor,
        texel_mm=stack.texel_mm and stack.texel_mm * factor,
    )
    write_metadata(path, coarse)


def _coarse_shard(stack: Stack, first: int, factor: int) -> Radiance:
    """Return the coarse pictures of a shard's lights, made from bands of rows."""
    lights = range(first, min(first + SHARD, len(stack.lights)))
    width = stack.width // factor * factor
    bands = range(0, stack.height // factor * factor, CHUNK * factor)
    ends = [min(y + CHUNK * factor, stack.height // factor * factor) for y in bands]
    parts = [average(stack.read_tile(y, end, 0, width, lights), factor) for y, end in zip(bands, ends, strict=True)]
    return Radiance(
        np.concatenate([part.value for part in parts], 1), np.concatenate([part.flags for part in parts], 1)
    )


def _link(source: Path, path: Path, shard: int) -> None:
    """Link a shard that does not change, or copy it where the disk has no links."""
    for name in NAMES:
        old, new = shard_path(source, name, shard), shard_path(path, name, shard)
        new.parent.mkdir(parents=True, exist_ok=True)
        try:
            os.link(old, new)
        except OSError:
            shutil.copyfile(old, new)
