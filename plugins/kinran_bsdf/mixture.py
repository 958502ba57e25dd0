"""Lobes of neighbouring texels as the lobes of one: a mixture of Gaussians over slopes, reduced.

The lobes of neighbours need not correspond. In one fabric the first lobe is the narrow one everywhere; in another it
lies on one flank of a rib in one texel, and on the other flank in the next. So lobes are grouped in two ways, and each
texel takes the one with the smaller integrated squared error over slopes, which has a closed form for Gaussians.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran_bsdf.models.model import WIDTH_FLOOR, Model

Array = NDArray[np.floating[Any]]


def mean(values: Array) -> Array:
    """Filter maps (…, H, W) by a box to half the size, rounded down; an odd size gives cells of over two texels."""
    result: Any = values
    for axis in (-2, -1):
        size = result.shape[axis]
        if size % 2 == 0:
            one, other = (result[..., k::2, :] if axis == -2 else result[..., k::2] for k in (0, 1))
            result = 0.5 * (one + other)
        elif size > 1:
            edges = np.linspace(0, size, size // 2 + 1)
            whole = np.minimum(edges.astype(int), size - 1)
            part = edges - whole if axis == -1 else (edges - whole)[:, None]
            before = np.cumsum(result, axis, dtype=np.float64) - result
            sums = np.take(before, whole, axis) + part * np.take(result, whole, axis)
            result = (np.diff(sums, axis=axis) * (size // 2 / size)).astype(values.dtype)
    return np.asarray(result)


def weights_of(energies: Array, shapes: Array, model: Model) -> Array:
    """Return the weights (lobes, H, W) of a map's lobes in the shapes of its pyramid: energy times √amplitude.

    With weights of energy, faint wide lobes would blunt a bright narrow one; with energy times amplitude, a lobe's part
    in a squared error, a few bright lobes would represent all.

    Parameters
    ----------
    energies : (lobes, bands, H, W)
        Albedo of each lobe.
    shapes : (lobes, 5, H, W)
        Shapes x, y, xx, xy, yy.
    model
        Model of the lobes.
    """
    energy = energies.sum(1)
    return np.asarray(energy * np.sqrt(energy / _unit(shapes, model)))


def reduced(energies: Array, shapes: Array, weights: Array, model: Model) -> tuple[Array, Array, Array]:
    """Reduce the lobes of a map to as many lobes in half the texels each way, with the same energy in each band.

    Lobes are grouped by their number, or by their side of the mean slope. A group becomes a lobe with the mean and the
    variance of its slopes (LEAN mapping [Olano2010]).

    Parameters
    ----------
    energies : (lobes, bands, H, W)
        Albedo of each lobe.
    shapes : (lobes, 5, H, W)
        Shapes x, y, xx, xy, yy.
    weights : (lobes, H, W)
        Weights of `weights_of`, or of the level before.
    model
        Model of the lobes.

    Returns
    -------
    tuple of arrays
        Energies, shapes and weights of the next level.
    """
    best = _grouped(np.arange(len(shapes))[:, None, None], energies, shapes, weights, model)
    if len(shapes) == 1:
        return best
    other = _grouped(_flanks(shapes, energies.sum(1)), energies, shapes, weights, model)
    worse = _error(energies, shapes, *best[:2], model) > _error(energies, shapes, *other[:2], model)
    first, second, third = (np.where(worse, b, a) for a, b in zip(best, other, strict=True))
    return first, second, third


def out_of_order(energies: Array, shapes: Array) -> NDArray[np.bool_]:
    """Return where (h, w) two lobes have to change places to have the same order everywhere.

    Then the next level, and a look-up between texels, mix like with like. The order is along the axis, in slopes and
    widths, on which the two lobes differ most in the whole map.
    """
    width = np.sqrt(shapes[:, [2, 4]].sum((0, 1)))
    size = shapes[:, 2] * shapes[:, 4] - shapes[:, 3] ** 2
    difference = [*(shapes[1, :2] - shapes[0, :2]) / width, 0.5 * np.log(np.maximum(size[1] / size[0], 1e-12))]
    columns = np.stack([d.ravel() for d in difference]).astype(float)
    axis = np.linalg.eigh(columns * energies.sum(1).prod(0).ravel() @ columns.T)[1][:, -1]
    return np.asarray((axis @ columns < 0).reshape(width.shape))


def _unit(shapes: Array, model: Model) -> Array:
    """Return the albedo of lobes (…, 5, H, W) of amplitude 1."""
    return np.asarray(model.albedo(np.moveaxis(shapes, -3, 0)))


def _grouped(
    groups: NDArray[Any], energies: Array, shapes: Array, weights: Array, model: Model
) -> tuple[Array, Array, Array]:
    members = [groups == k for k in range(len(shapes))]
    energy = np.stack([mean((energies * m[:, None]).sum(0)) for m in members])
    shape = np.stack([_pooled(shapes, weights * m, model.spread) for m in members])
    return energy, shape, np.stack([mean((weights * m).sum(0)) for m in members])


def _pooled(shapes: Array, weights: Array, spread: int) -> Array:
    """Return the shape (5, h, w) with the mean and variance of the lobes' slopes; equally weighted where all are 0."""
    weights = weights + np.float32(1e-9 * weights.mean() + 1e-30)
    x, y, xx, xy, yy = np.moveaxis(shapes, 1, 0)
    moments = [x, y, xx + spread * x * x, xy + spread * x * y, yy + spread * y * y]
    total = mean(weights.sum(0))
    x, y, xx, xy, yy = (mean((weights * m).sum(0)) / total for m in moments)
    # single precision leaves nothing of the narrowest widths at steep slopes
    xx, yy = (np.maximum(a - spread * b * b, WIDTH_FLOOR**2) for a, b in ((xx, x), (yy, y)))
    most = np.float32(0.99999) * np.sqrt(xx * yy)
    return np.stack([x, y, xx, np.clip(xy - spread * x * y, -most, most), yy])


def _flanks(shapes: Array, weights: Array) -> Array:
    """Return the side (0 or 1) of the mean slope on which each of two lobes is, on the axis of greatest spread."""
    points = shapes.copy()
    points[:, 2:] = 0  # so that the spread is only a scale
    x, y, xx, xy, yy = _pooled(points, weights, 2)
    turn = 0.5 * np.arctan2(2 * xy, xx - yy)
    x, y, c, s = _spread(np.stack([x, y, np.cos(turn), np.sin(turn)]), shapes)
    return (shapes[:, 0] - x) * c + (shapes[:, 1] - y) * s > 0


def _spread(coarse: Any, like: Array) -> Array:
    """Return the values (…, H, W) of the coarse texels (…, h, w) that contain the centres of the fine ones."""
    for axis in (-2, -1):
        size, few = like.shape[axis], coarse.shape[axis]
        coarse = np.take(coarse, ((np.arange(size) + 0.5) * few / size).astype(int), axis)
    return np.asarray(coarse)


def _error(energies: Array, shapes: Array, found: Any, forms: Any, model: Model) -> Array:
    """Return ∫ (found − lobes)² over slopes (h, w), without the part that does not depend on `found`."""
    peaks, sums = energies / _unit(shapes, model)[:, None], found / _unit(forms, model)[:, None]
    own = sum(_product(a, b, p, q) for a, p in zip(sums, forms, strict=True) for b, q in zip(sums, forms, strict=True))
    sums, forms = _spread(sums, shapes), _spread(forms, shapes)
    cross = [_product(a, b, p, q) for a, p in zip(peaks, shapes, strict=True) for b, q in zip(sums, forms, strict=True)]
    return np.asarray(own - 2 * mean(np.sum(cross, 0)))


def _product(one: Array, other: Array, p: Array, q: Array) -> Array:
    """Return ∫ / π of the product of two lobes over slopes, summed over bands: (bands, H, W), shapes (5, H, W)."""
    dx, dy = p[0] - q[0], p[1] - q[1]
    xx, xy, yy = p[2:] + q[2:]
    size = xx * yy - xy * xy
    overlap = np.exp(-(yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / size)
    areas = (p[2] * p[4] - p[3] * p[3]) * (q[2] * q[4] - q[3] * q[3])
    return np.asarray((one * other).sum(0) * overlap * np.sqrt(np.maximum(areas, 0) / size))
