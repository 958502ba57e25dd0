"""Segment a fabric into regions of one kind of thread, by Mahalanobis distance in a colour space.

Takeda2008, §3.1. The colour space is made of statistics over all training lights, not of one photograph. The
regions start from patches that a person points at, or are found; their number is given, or chosen.
"""

import logging
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from kinran.base.exr import write_exr
from kinran.base.files import NAME, InputError
from kinran.data.fabric import Fabric
from kinran.data.labels import Region, write_labels, write_regions
from kinran.segment import mahalanobis
from kinran.segment.appearance import Appearance, over_lights
from kinran_bsdf.colours import TO_REC709

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

LEAST_TEXELS = 32
"""Fewest texels of a region: eight for each of the four features whose covariance they tell. A choice."""
LEAST_SHARE = 0.005
"""Least share of the texels of a region: the virtual brocade's smallest has 5 %. No measurement stands behind the
share."""
SEED = re.compile(rf"({NAME.pattern}):([0-9]{{1,6}}),([0-9]{{1,6}})")


@dataclass(frozen=True)
class Options:
    count: Annotated[int | None, "number of regions (default: as many as the data tell apart)"] = None
    seeds: Annotated[
        str, "--seeds NAME:X,Y;…", "texels of each region, from the top left of the label map; several of a name help"
    ] = ""


def main(
    fabric: Annotated[Path, "folder of the radiance stack, for label map, regions and statistics as well"],
    options: Options = Options(),
) -> None:
    """Write the label map, the regions and the statistics that they were found by.

    Raises
    ------
    InputError
        A seed is wrong, or the texels are too few or too alike for the regions.
    """
    seeds, known = parse_seeds(options.seeds), Fabric(fabric)
    look = over_lights(known.stack)
    found = segment(look, options.count, seeds, str(known.labels_path))
    shape = look.middle.shape
    labels = found.labels.reshape(shape)
    if not look.inside.all():
        log.info("%d texels are outside the mask, and belong to no region", int((~look.inside).sum()))
    write_labels(
        known.labels_path,
        labels,
        found.confidence.reshape(shape).astype(np.float32),
        found.second.reshape(shape),
        found.membership.reshape(shape).astype(np.float32),
    )
    regions = describe(labels, look, known.stack.to_acescg, found.names)
    write_regions(known.regions_path, regions)
    planes = {name: look.median[..., k] for k, name in enumerate(("median.R", "median.G", "median.B"))}
    write_exr(fabric / "statistics.exr", {**planes, "luminance.p98": look.peak, "luminance.p40": look.middle})
    for region in regions:
        log.info("%s: %d texels", region.name, region.texels)


@dataclass(frozen=True)
class Seed:
    """A texel that a person says belongs to a region; x, y from the top left of the label map."""

    name: str
    x: int
    y: int


@dataclass(frozen=True)
class Segmentation:
    """Regions of a fabric, texel by texel.

    Attributes
    ----------
    labels, second : (texel,) int
        Region of each texel, and the one that shares the texel with it (the same where none does). Region 0 is the
        shiniest.
    confidence, membership : (texel,) float
        Probability that the label is right, and share of the region in the texel.
    names
        Names of the regions, where a person gave them; otherwise empty.
    """

    labels: Labels
    second: Labels
    confidence: Array
    membership: Array
    names: tuple[str, ...]


def parse_seeds(text: str) -> list[Seed]:
    """Seeds of ``NAME:X,Y;NAME:X,Y``.

    Raises
    ------
    InputError
        A part does not have that form.
    """
    seeds = []
    for part in filter(None, (part.strip() for part in text.split(";"))):
        match = SEED.fullmatch(part)
        if match is None:
            raise InputError(f"seeds: '{part}' is not NAME:X,Y such as gold:12,30; names use a-z, 0-9, _ and -")
        seeds.append(Seed(match[1], int(match[2]), int(match[3])))
    return seeds


def segment(look: Appearance, count: int | None, seeds: list[Seed], name: str) -> Segmentation:
    """Segment the texels of a fabric into regions (Takeda2008, §3.1).

    Parameters
    ----------
    look
        Statistics over the lights.
    count
        Number of regions; None for that of the seeds, or for as many as the data tell apart.
    seeds
        Texels of regions; a 3 × 3 patch around each is taken.
    name
        Name of the data, for errors.

    Raises
    ------
    InputError
        Fewer texels than regions need, a region that was asked for has too few of them, or the seeds do not
        fit the map or the number.
    """
    features, shape, inside = look.features(), look.middle.shape, look.inside.reshape(-1)
    least = max(LEAST_TEXELS, int(LEAST_SHARE * len(features)))
    if len(features) < least:
        raise InputError(f"{name}: {len(features)} texels are too few to segment; {least} are needed")
    names: tuple[str, ...] = ()
    fixed = np.full(len(features), -1, np.intp)
    strict = bool(seeds) or count is not None
    if seeds:
        names, planted = plant(seeds, (shape[0], shape[1]), name)
        fixed = planted[inside]
        if count not in (None, len(names)):
            raise InputError(f"{name}: the seeds name {len(names)} regions but {count} are asked for; correct one")
        count = len(names)
    elif count is None:
        count = mahalanobis.choose_count(features, least)
    while True:
        distances, labels = _find(features, look.inside, count, fixed, name)
        sizes = np.bincount(labels[inside], minlength=count)
        if sizes.min() >= least:
            break
        if strict:
            small = f"'{names[sizes.argmin()]}'" if names else "one"
            raise InputError(
                f"{name}: with {count} regions {small} has only {sizes.min()} texels ({least} are needed);"
                " ask for fewer regions"
            )
        count -= 1
    order = np.argsort(
        [-np.median(look.shininess.reshape(-1)[inside & (labels == k)]) for k in range(count)], kind="stable"
    )
    distances, labels = distances[:, order], np.argsort(order)[labels].astype(np.intp)
    second, share = mahalanobis.membership(distances, labels, (shape[0], shape[1]))
    sure = mahalanobis.confidence(distances, labels)
    return Segmentation(labels, second, sure, share, tuple(names[k] for k in order) if names else ())


def plant(seeds: list[Seed], shape: tuple[int, int], name: str) -> tuple[tuple[str, ...], Labels]:
    """Names of the seeded regions and the label (texel,) of the texels in their patches, -1 elsewhere."""
    height, width = shape
    names = tuple(dict.fromkeys(seed.name for seed in seeds))
    fixed = np.full(shape, -1, np.intp)
    for seed in seeds:
        if seed.x >= width or seed.y >= height:
            raise InputError(
                f"{name}: the seed {seed.name}:{seed.x},{seed.y} lies outside the {width} × {height} texels;"
                " count from the top left"
            )
        row = height - 1 - seed.y
        fixed[max(row - 1, 0) : row + 2, max(seed.x - 1, 0) : seed.x + 2] = names.index(seed.name)
    return names, fixed.reshape(-1)


def _find(features: Array, inside: NDArray[np.bool_], count: int, fixed: Labels, name: str) -> tuple[Array, Labels]:
    """Squared distances (texel, count) to the regions, and labels (texel,), of all texels.

    Those outside a mask (y, x) have the distances of the nearest texel inside.
    """
    different = len(np.unique(mahalanobis.sample(features), axis=0))
    if different < count:
        raise InputError(
            f"{name}: all texels look alike ({different} kinds for {count} regions); ask for fewer regions"
        )
    planted = (fixed >= 0).any()
    regions = mahalanobis.grow(features, fixed, count) if planted else mahalanobis.search(features, count)
    distances = np.zeros((inside.size, count))
    distances[inside.reshape(-1)] = regions.distances(features)
    if not inside.all():
        _, (y, x) = distance_transform_edt(~inside, return_indices=True)
        distances = distances.reshape(*inside.shape, count)[y, x].reshape(-1, count)
    return distances, mahalanobis.settle(distances, (inside.shape[0], inside.shape[1]))


def describe(labels: Labels, look: Appearance, to_acescg: Array, names: tuple[str, ...] = ()) -> list[Region]:
    """Regions with size, colour and shininess; the name of each is the given one, or one after its colour."""
    regions: list[Region] = []
    taken: dict[str, int] = {}
    for k in range(int(labels.max()) + 1):
        inside = (labels == k) & look.inside
        rgb = TO_REC709 @ (to_acescg @ np.median(look.median[inside], axis=0))
        name = names[k] if names else colour_name(rgb)
        taken[name] = taken.get(name, 0) + 1
        if taken[name] > 1:
            name = f"{name}-{taken[name]}"
        r, g, b = (round(float(v), 5) for v in rgb)
        shininess = round(float(np.median(look.shininess[inside])), 4)
        regions.append(Region(k, name, int(inside.sum()), (r, g, b), shininess))
    return regions


def colour_name(rgb: Array) -> str:
    """Plain name of a linear Rec. 709 colour."""
    r, g, b = np.maximum(rgb, 0)
    high, low = max(r, g, b), min(r, g, b)
    if high < 0.02:
        return "dark"
    if high - low < 0.25 * high:
        return "white" if high > 0.3 else "grey"
    if high == r:
        hue = 60 * (g - b) / (high - low)
    elif high == g:
        hue = 120 + 60 * (b - r) / (high - low)
    else:
        hue = 240 + 60 * (r - g) / (high - low)
    limits = ((18, "red"), (65, "gold"), (160, "green"), (265, "blue"), (330, "purple"), (360, "red"))
    return next(name for limit, name in limits if hue % 360 <= limit)
