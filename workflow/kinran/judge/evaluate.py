"""Error of each fitted material on the held-out lights, by region and by light."""

import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran.base.files import InputError, read_json, write_json
from kinran.data import material_prediction, metrics
from kinran.data.fabric import Fabric
from kinran.data.held_out_photographs import HeldOut, Survey, survey
from kinran.data.radiance_stack import Box, Stack
from kinran.data.verdict import told
from kinran.judge.block_means import BlockMeans
from kinran.judge.simple_baselines import SimpleBaselines
from kinran.judge.tally import Tally
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import read_material

log = logging.getLogger(__name__)

Images = NDArray[np.float32]

SHOWN = 3
"""Held-out lights in the picture: the brightest, the darkest and the one between them."""
LARGEST = 480
"""Most pixels along a side of a picture of it: larger fabrics are shown by the means of blocks. A choice."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    materials: Annotated[tuple[Path, ...], "MODEL.exr beside its MODEL.json; the first is the default"]


@dataclass(frozen=True)
class Outputs:
    """Files that the stage writes."""

    errors: Annotated[Path, "OUT", "errors (.json)"]
    picture: Annotated[Path, "held-out photographs beside predictions (.png)"]


@dataclass(frozen=True)
class Options:
    """Name that the errors are filed under."""

    name: Annotated[str, "name of the fabric"]


def main(inputs: Inputs, out: Outputs, options: Options) -> None:
    """Write the errors of all materials; the first one is the default.

    Raises
    ------
    InputError
        A material is not of the size of the fabric.
    """
    fabric = Fabric(inputs.fabric)
    stack = fabric.stack
    result: dict[str, Any] = {
        "fabric": options.name,
        "default": inputs.materials[0].stem,
        "unit": stack.unit,
        "psnr_of": stack.encoding or f"log(1 + {metrics.LOG_COMPRESSION:g} x / p99.9)",
        "training_lights": int((~stack.held_out).sum()),
        "held_out": [light.name for light in stack.lights if light.held_out],
        "regions": {region.name: region.texels for region in fabric.regions},
        "methods": {},
    }
    if stack.held_out.any():
        judged, result["beside"], picture = _judge(inputs.materials, fabric)
        for name, errors in judged.items():
            result["methods"][name] = errors
        pictures.write_png(out.picture, picture)
    else:
        empty = np.full((40, 360, 3), 250, np.uint8)
        said = pictures.sheet([[("no light was held out: there is nothing to judge by", empty)]])
        pictures.write_png(out.picture, said)
    for path in inputs.materials:
        result["methods"].setdefault(path.stem, {})["fit"] = read_json(path.with_suffix(".json"))
    write_json(out.errors, result)
    log.info("%s", told(options.name, result))


def _judge(
    paths: tuple[Path, ...], fabric: Fabric
) -> tuple[dict[str, dict[str, Any]], dict[str, Any], pictures.Picture]:
    """Return the errors of each material, those of baselines beside the default, and the picture.

    One tile of the photographs is in memory at a time.
    """
    stack, seen = fabric.stack, survey(fabric.stack)
    materials = {path.stem: read_material(path) for path in paths}
    for path in paths:
        if materials[path.stem].channels["label"].shape != (stack.height, stack.width):
            raise InputError(f"{path}: its size is not that of {stack.path}; fit it again")
    tallies = {name: Tally(seen, fabric.regions) for name in materials}
    seconds = dict.fromkeys(materials, 0.0)
    beside = SimpleBaselines(fabric, seen)
    picture = _Picture(stack, seen, tuple(materials))
    for box in stack.tiles():
        held = HeldOut.read(stack, box, seen.peak)
        predicted = {}
        for name, material in materials.items():
            start = time.process_time()
            predicted[name] = material_prediction.predict(material, stack, box, held.use)
            seconds[name] += time.process_time() - start
            tallies[name].add(held, predicted[name], fabric.labels[box[0] : box[1], box[2] : box[3]].reshape(-1))
        beside.add(box, held, predicted[paths[0].stem])
        picture.add(box, held, predicted)
    errors = {name: {**tallies[name].errors(), "relight_cpu_seconds": round(seconds[name], 3)} for name in materials}
    return errors, beside.errors(), picture.sheet()


class _Picture:
    """Rows of held-out lights: the photograph, then each prediction and its error."""

    def __init__(self, stack: Stack, seen: Survey, names: tuple[str, ...]) -> None:
        order = np.argsort(-seen.mean)
        self._lights = order[np.linspace(0, len(order) - 1, min(SHOWN, len(order))).astype(int)]
        self._names = [seen.lights[i].name for i in self._lights]
        self._stack, step = stack, max(1, math.ceil(max(stack.height, stack.width) / LARGEST))

        def means(channels: int) -> BlockMeans:
            return BlockMeans((len(self._lights), stack.height, stack.width, channels), step)

        self._truth, self._predicted = means(3), {name: (means(3), means(1)) for name in names}

    def add(self, box: Box, held: HeldOut, predicted: dict[str, Images]) -> None:
        """Add a tile: its photographs, and the predictions of each material."""
        truth = held.truth[self._lights]
        self._truth.add(box, truth)
        for name, (light, error) in self._predicted.items():
            image = predicted[name][self._lights]
            light.add(box, image)
            error.add(box, np.abs(held.shown(image) - held.shown(truth)).mean(-1, keepdims=True))

    def sheet(self) -> pictures.Picture:
        """Return the picture."""
        to_rec709 = (TO_REC709 @ self._stack.to_acescg).T
        truth = self._truth.images() @ to_rec709
        size = max(160, min(240, truth.shape[2]))
        rows = []
        for i, name_of_light in enumerate(self._names):
            exposure = 1.0 if self._stack.encoding else pictures.auto_exposure(truth[i])
            row = [(name_of_light, pictures.enlarge(pictures.photograph(truth[i], exposure), size))]
            for name, (predicted, error) in self._predicted.items():
                shown = pictures.photograph(predicted.images()[i] @ to_rec709, exposure)
                row.append((name, pictures.enlarge(shown, size)))
                heat = pictures.heat(error.images()[i, ..., 0], 0.25)
                row.append((f"{name}: error, to 0.25", pictures.enlarge(heat, size)))
            rows.append(row)
        return pictures.sheet(rows)
