"""What a scene needs of a fabric: what later stages take from the file that `kinran need` writes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinran.base.files import InputError, read_as
from kinran.data.labels import LabelMap

SHOWN = 1e-3
"""Least share of the cloth's pixels from which a region counts as shown: 250 pixels where it fills a picture of 500 ×
500. No measurement stands behind the share."""


@dataclass(frozen=True)
class SeenRegion:
    """A region of the fabric, and whether the scene needs a lobe for it."""

    label: int
    needed: bool


@dataclass(frozen=True)
class Footprint:
    """What a pixel covers of the cloth.

    Attributes
    ----------
    coarsest_factor
        Texels along a side that can be averaged to one without anybody seeing it.
    """

    coarsest_factor: int


@dataclass(frozen=True)
class Need:
    """What a scene needs of a fabric; the file says more, for people."""

    regions: tuple[SeenRegion, ...]
    footprint: Footprint


def read_need(path: Path) -> Need:
    """Read what a scene needs.

    Raises
    ------
    InputError
        The file is missing or is something else.
    """
    return read_as(path, Need, "what a scene needs", "make it with kinran need")


def needed_labels(path: Path, labels: LabelMap) -> list[int]:
    """Labels of the regions that need a lobe.

    Parameters
    ----------
    path
        What the scene needs (.json).
    labels : (y, x) int
        Label map of the fabric.

    Raises
    ------
    InputError
        The file is missing, is something else, or was made for another label map.
    """
    rows = {region.label: region.needed for region in read_need(path).regions}
    if unknown := set(np.unique(labels).tolist()) - rows.keys():
        raise InputError(f"{path}: says nothing of the label {min(unknown)}; make it again with kinran need")
    return sorted(label for label, needed in rows.items() if needed)
