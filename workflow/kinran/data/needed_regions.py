"""The need of a scene: the part of the file of `kinran need` that later stages read."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinran.base.files import InputError, read_as
from kinran.data.labels import LabelMap

SHOWN = 1e-3
"""Least share of the cloth's pixels from which a region counts as shown: 250 pixels where the cloth fills a picture of
500 × 500. No measurement stands behind it."""


@dataclass(frozen=True)
class SeenRegion:
    """A region of the fabric, and whether the scene needs a lobe for it."""

    label: int
    needed: bool


@dataclass(frozen=True)
class Footprint:
    """Area of the cloth that a pixel covers.

    Attributes
    ----------
    coarsest_factor
        Most texels along a side whose average the scene's camera cannot tell from them.
    """

    coarsest_factor: int


@dataclass(frozen=True)
class Need:
    """Need of a scene for a fabric; the file holds more, for readers."""

    regions: tuple[SeenRegion, ...]
    footprint: Footprint


def read_need(path: Path) -> Need:
    """Read the need of a scene.

    Raises
    ------
    InputError
        The file is missing or is not the need of a scene.
    """
    return read_as(path, Need, "what a scene needs", "make it with kinran need")


def needed_labels(path: Path, labels: LabelMap) -> list[int]:
    """Return the sorted labels of the regions that need a lobe.

    Parameters
    ----------
    path
        Need of the scene (.json).
    labels : (y, x) int
        Label map of the fabric.

    Raises
    ------
    InputError
        The file is missing, is not the need of a scene, or was made for another label map.
    """
    rows = {region.label: region.needed for region in read_need(path).regions}
    if unknown := set(np.unique(labels).tolist()) - rows.keys():
        raise InputError(f"{path}: says nothing of the label {min(unknown)}; make it again with kinran need")
    return sorted(label for label, needed in rows.items() if needed)
