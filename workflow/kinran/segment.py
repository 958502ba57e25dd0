"""Segment a fabric into regions of one kind of thread, by Mahalanobis distance in a colour space.

Takeda2008, §3.1. The colour space is made of statistics over all training lights, not of one photograph: the
logarithmic chroma of the median, the luminance and the shininess of each texel.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2
from scipy.ndimage import uniform_filter

from kinran.exr import write_exr
from kinran.files import InputError
from kinran.labels import Region, write_labels, write_regions
from kinran.stack import Stack
from kinran_bsdf.colours import TO_REC709

Array = NDArray[np.float64]

AUTOMATIC = 4
LEAST_TEXELS = 32
LEAST_SHARE = 0.005
STARTS = 10
ROUNDS = 20


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--stack", type=Path, required=True, help="radiance stack (.zarr)")
    parser.add_argument("--count", type=int, help="number of regions (default: up to 4, those that hold)")
    parser.add_argument("--regions", type=Path, required=True, help="what is known of each region (.json)")
    parser.add_argument("--statistics", type=Path, required=True, help="statistics over the lights (.exr)")
    parser.add_argument("out", type=Path, help="label map (.exr)")


def main(args: argparse.Namespace) -> None:
    """Write the label map, the regions and the statistics that they were found by."""
    stack = Stack.open(args.stack)
    median, peak, middle = statistics(stack)
    features = standardised(median, peak, middle)
    shape = median.shape[:2]
    labels, distance = cluster(features, args.count or AUTOMATIC, str(args.out), strict=args.count is not None)
    labels = _by_shininess(labels, np.log((peak + 1e-4) / (middle + 1e-4)).reshape(-1))
    regions = describe(labels.reshape(shape), median, peak, middle, stack.to_acescg)
    write_labels(args.out, labels.reshape(shape), np.exp(-0.5 * distance).reshape(shape).astype(np.float32))
    write_regions(args.regions, regions)
    planes = {name: median[..., k] for k, name in enumerate(("median.R", "median.G", "median.B"))}
    write_exr(args.statistics, {**planes, "luminance.p98": peak, "luminance.p40": middle})
    for region in regions:
        print(f"{region.name}: {region.texels} texels", file=sys.stderr)


def statistics(
    stack: Stack,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Statistics of each texel over the training lights, saturated samples included.

    Returns
    -------
    median : (y, x, 3) float32
        Median of T / cos θ_i over lights within 60° of the normal.
    p98, p40 : (y, x) float32
        Percentiles of luminance (mean of the channels).
    """
    use = np.array([i for i, light in enumerate(stack.lights) if not light.held_out])
    cosine = np.array([stack.lights[i].direction[2] for i in use])
    high = cosine > 0.5 if (cosine > 0.5).sum() >= 3 else np.ones(len(cosine), bool)
    median = np.zeros((stack.height, stack.width, 3), np.float32)
    peak, middle = np.zeros(median.shape[:2], np.float32), np.zeros(median.shape[:2], np.float32)
    for y0, y1, x0, x1 in stack.tiles():
        radiance = np.nan_to_num(stack.read_tile(y0, y1, x0, x1, lights=use)[0], posinf=0, neginf=0)
        median[y0:y1, x0:x1] = np.median(radiance[high] / cosine[high, None, None, None], axis=0)
        middle[y0:y1, x0:x1], peak[y0:y1, x0:x1] = np.percentile(radiance.mean(-1), (40, 98), axis=0)
    return median, peak, middle


def standardised(median: NDArray[np.float32], peak: NDArray[np.float32], middle: NDArray[np.float32]) -> Array:
    """Features (texel, 4): log chroma (R/G, B/G), log luminance, shininess; each of unit spread."""
    floor = 1e-3 * max(float(np.percentile(median, 99)), 1e-6) + 1e-6
    m = np.log(np.maximum(median.astype(float), 0) + floor)
    shininess = np.log(np.maximum(peak, 0) + floor) - np.log(np.maximum(middle, 0) + floor)
    columns = np.stack([m[..., 0] - m[..., 1], m[..., 2] - m[..., 1], 0.5 * m.mean(-1), shininess], -1)
    # a thread is wider than a texel: its neighbours speak for it, too
    columns = uniform_filter(columns, size=(3, 3, 1), mode="nearest").reshape(-1, 4)
    spread = columns.std(0)
    return np.asarray((columns - columns.mean(0)) / np.where(spread > 1e-6, spread, 1.0))


def cluster(features: Array, count: int, name: str, strict: bool) -> tuple[NDArray[np.intp], Array]:
    """Regions by Mahalanobis distance with shrunk covariances, from the best of several k-means starts.

    Parameters
    ----------
    features : (texel, d) float
    count
        Number of regions.
    name
        What to call the data in an error.
    strict
        Whether a region that is too small is an error; otherwise it is given up and its texels go elsewhere.

    Returns
    -------
    labels : (texel,) int
    distance : (texel,) float
        Squared Mahalanobis distance to the region's mean.

    Raises
    ------
    InputError
        Fewer texels than regions need, or (strict) a region with too few of them.
    """
    least = max(LEAST_TEXELS, int(LEAST_SHARE * len(features)))
    if len(features) < least:
        raise InputError(f"{name}: {len(features)} texels are too few to segment; {least} are needed")
    different = len(np.unique(features[:: max(1, len(features) // 20000)], axis=0))
    count = count if strict else min(count, different)
    if different < count:
        raise InputError(f"{name}: all texels look alike ({different} kinds for {count} regions); ask for fewer regions")
    while True:
        labels = _kmeans(features, count)
        for _ in range(ROUNDS):
            distance = _mahalanobis(features, labels, count)
            new = distance.argmin(1)
            if (new == labels).all():
                break
            labels = new
        sizes = np.bincount(labels, minlength=count)
        if sizes.min() >= least:
            labels = labels.astype(np.intp)
            return labels, _mahalanobis(features, labels, count)[np.arange(len(labels)), labels]
        if strict:
            raise InputError(
                f"{name}: with {count} regions one has only {sizes.min()} texels ({least} are needed);"
                " ask for fewer regions"
            )
        count = min(int((sizes >= least).sum()), count - 1)


def _kmeans(features: Array, count: int) -> NDArray[np.intp]:
    best, labels = np.inf, np.zeros(len(features), np.intp)
    if count == 1:
        return labels
    for seed in range(STARTS):
        centres, found = kmeans2(features, count, minit="++", iter=30, rng=seed)
        inertia = float(((features - centres[found]) ** 2).sum())
        if inertia < best:
            best, labels = inertia, found.astype(np.intp)
    return labels


def _mahalanobis(features: Array, labels: NDArray[np.intp], count: int) -> Array:
    """Squared distances (texel, count) under covariances shrunk half-way to their mean."""
    d = features.shape[1]
    means, covariances, sizes = np.zeros((count, d)), np.zeros((count, d, d)), np.zeros(count)
    for k in range(count):
        inside = features[labels == k]
        sizes[k] = len(inside)
        means[k] = inside.mean(0) if len(inside) else np.inf
        covariances[k] = np.cov(inside.T) if len(inside) > d else np.eye(d)
    shared = (covariances * sizes[:, None, None]).sum(0) / sizes.sum()
    distance = np.full((len(features), count), np.inf)
    for k in np.flatnonzero(sizes):
        inverse = np.linalg.inv(0.5 * covariances[k] + 0.5 * shared + 1e-3 * np.eye(d))
        x = features - means[k]
        distance[:, k] = np.einsum("ti,ij,tj->t", x, inverse, x)
    return distance


def _by_shininess(labels: NDArray[np.intp], shininess: Array) -> NDArray[np.intp]:
    """Number the regions from the shiniest on, so that a rerun gives the same numbers."""
    order = sorted(np.unique(labels), key=lambda k: -float(np.median(shininess[labels == k])))
    rank = np.zeros(int(labels.max()) + 1, np.intp)
    rank[order] = np.arange(len(order))
    return rank[labels]


def describe(
    labels: NDArray[np.intp],
    median: NDArray[np.float32],
    peak: NDArray[np.float32],
    middle: NDArray[np.float32],
    to_acescg: Array,
) -> list[Region]:
    """What is known of each region, with a name that says what it looks like."""
    regions: list[Region] = []
    taken: dict[str, int] = {}
    for k in range(int(labels.max()) + 1):
        inside = labels == k
        rgb = TO_REC709 @ (to_acescg @ np.median(median[inside], axis=0))
        shininess = float(np.median(np.log((peak[inside] + 1e-4) / (middle[inside] + 1e-4))))
        name = colour_name(rgb)
        taken[name] = taken.get(name, 0) + 1
        if taken[name] > 1:
            name = f"{name}-{taken[name]}"
        r, g, b = (round(float(v), 5) for v in rgb)
        regions.append(Region(k, name, int(inside.sum()), (r, g, b), round(shininess, 4)))
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
