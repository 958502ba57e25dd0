"""The label map of a fabric, and its regions."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.exr import read_channel, write_exr
from kinran.base.files import read_as, write_json

LabelMap = NDArray[np.uint16]
"""Region (y, x) of each texel."""

MIXED = 0.8
"""Share of its label's region below which a texel counts as mixed. `segment.mahalanobis.membership` estimates the share
at the virtual fabric's edges with a mean error of 0.10, so that two errors lie between this and an unmixed texel."""


@dataclass(frozen=True)
class Region:
    """A region of one kind of thread.

    Attributes
    ----------
    label
        Value of the region in the label map.
    name
        Name by the region's look, such as ``gold`` or ``red``; unique in a fabric.
    texels
        Number of texels.
    colour
        Mean linear Rec. 709 colour over the lights, for display.
    shininess
        Median over the texels of ln(p98 / p40), percentiles of luminance over the lights.
    """

    label: int
    name: str
    texels: int
    colour: tuple[float, float, float]
    shininess: float


def write_labels(
    path: Path,
    labels: NDArray[np.intp],
    confidence: NDArray[np.float32],
    second: NDArray[np.intp],
    membership: NDArray[np.float32],
) -> None:
    """Write the label map (y, x) as channels.

    Parameters
    ----------
    labels, second : (y, x) int
        Region of each texel, and the one that shares it; the same where none does.
    confidence : (y, x) float32
        Probability that the label is right.
    membership : (y, x) float32
        Share of the label's region in the texel, in [0.5, 1]; the rest is the second's.
    """
    regions = {"label": labels.astype(np.float32), "second": second.astype(np.float32)}
    write_exr(path, {**regions, "confidence": confidence, "membership": membership})


def read_labels(path: Path) -> LabelMap:
    """Read a label map (y, x), two bytes a texel."""
    return read_channel(path, "label", np.uint16)


def read_second(path: Path, labels: LabelMap) -> LabelMap:
    """Read the region (y, x) that shares each texel by more than 1 − `MIXED`; the texel's own label where none does."""
    second = read_channel(path, "second", np.uint16)
    own = read_channel(path, "membership", np.float16) >= MIXED
    np.copyto(second, labels, where=own)
    return second


def write_regions(path: Path, regions: list[Region]) -> None:
    """Write the regions as JSON."""
    write_json(path, regions)


def read_regions(path: Path) -> list[Region]:
    """Read the regions.

    Raises
    ------
    InputError
        The file is missing or holds something else.
    """
    return read_as(path, list[Region], "a list of regions", "make it with kinran segment")
