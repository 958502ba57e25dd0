"""A material beside simple baselines: the same training lights, and the same held-out lights judge them."""

import functools
from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding
from kinran.compare.baselines import basis, encoded
from kinran.data.fabric import Fabric
from kinran.data.held_out_photographs import HeldOut, Survey
from kinran.data.radiance_stack import Box
from kinran.data.texel_directions import under
from kinran.fit import lambert
from kinran.fit.fitted_model import Fitted
from kinran.fit.harmonics import harmonics
from kinran.fit.samples import Samples, read_samples
from kinran.judge.tally import Tally

T_ = TypeVar("T_", bound=np.generic)
Images = NDArray[np.float32]

TILES = 16
"""Most tiles that baselines are fitted in, evenly through the fabric. A choice: reading them takes seconds."""
SAMPLES = 8_000_000
"""Most samples, of texels times lights, that baselines are fitted to. A choice: 16,384 texels under 480 lights."""


def _harmonics(samples: Samples, count: int) -> Fitted:
    return basis.fit(samples, harmonics(count), basis.RIDGE)


BASELINES: dict[str, tuple[int, Callable[[Samples, Encoding | None], Fitted]]] = {
    "Lambert": (3, lambda samples, _: lambert.fit(samples)),
    "PTM": (6, lambda samples, coder: encoded.fit(samples, coder, lambda s: basis.fit(s, basis.polynomial))),
    "HSH 9": (9, lambda samples, coder: encoded.fit(samples, coder, functools.partial(_harmonics, count=9))),
    "HSH 16": (16, lambda samples, coder: encoded.fit(samples, coder, functools.partial(_harmonics, count=16))),
}
"""Baselines by name: the fewest lights for each, and its fit to samples and their encoding."""


class SimpleBaselines:
    """The errors of simple baselines and of one material, in the same texels of some tiles.

    Parameters
    ----------
    fabric
        Fabric with held-out lights.
    seen
        Survey of their photographs.
    """

    def __init__(self, fabric: Fabric, seen: Survey) -> None:
        self._fabric = fabric
        boxes = fabric.stack.tiles()
        chosen = np.unique(np.linspace(0, len(boxes) - 1, min(TILES, len(boxes))).round().astype(int))
        self._boxes = {boxes[k] for k in chosen}
        training = int((~fabric.stack.held_out).sum())
        self._most = max(1, SAMPLES // (training * len(chosen)))
        self._fits = {name: fit for name, (least, fit) in BASELINES.items() if training >= least}
        self._material = Tally(seen, fabric.regions)
        self._tallies = {name: Tally(seen, fabric.regions) for name in self._fits}
        self._texels = 0

    def add(self, box: Box, held: HeldOut, predicted: Images) -> None:
        """Add a tile: its held-out photographs, and what the material predicts for them (light, y, x, 3)."""
        if box not in self._boxes or not self._fits:
            return
        stack = self._fabric.stack
        labels = self._fabric.labels[box[0] : box[1], box[2] : box[3]].reshape(-1)
        at = np.linspace(0, labels.size - 1, min(self._most, labels.size)).astype(np.intp)
        part = replace(held, truth=_row(held.truth, at), valid=_row(held.valid, at), full=_row(held.full, at))
        self._texels += len(at)
        self._material.add(part, _row(predicted, at), labels[at])
        samples, towards = read_samples(self._fabric, box).of(at), under(stack, box, held.use).of(at)
        for name, fit in self._fits.items():
            light = towards.reaching(fit(samples, held.coder).predict(towards))
            self._tallies[name].add(part, light.transpose(2, 0, 1)[:, None], labels[at])

    def errors(self) -> dict[str, Any]:
        """Return how many texels were judged, and the errors of the material and of each baseline there."""
        return {
            "texels": self._texels,
            "whole": self._texels == self._fabric.labels.size,
            "material": _short(self._material),
            "baselines": {name: _short(tally) for name, tally in self._tallies.items()},
        }


def _row(images: NDArray[T_], at: NDArray[np.intp]) -> NDArray[T_]:
    """Some texels of images (light, y, x, 3), as images of one row."""
    return images.reshape(len(images), 1, -1, 3)[:, :, at]


def _short(tally: Tally) -> dict[str, float]:
    errors = tally.errors()
    return {name: errors[name] for name in ("psnr", "relative_error")}
