"""Lamps at finite distances: what direction and irradiance each texel has, and a fit that knows them."""

import numpy as np
from numpy.typing import NDArray

from kinran.fit import slope
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE
from kinran.fit.slope import Prior, SlopeFit

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

CELL = 0.002
"""Radians that a light may turn within a cell of texels, which share its directions."""


def illumination(positions: Array, points: Array) -> tuple[Array, Array]:
    """Directions and relative irradiance of point lamps.

    Parameters
    ----------
    positions : (light, 3) float
        Lamps in millimetres from the field's centre.
    points : (texel, 2) float
        Texels in millimetres from the field's centre, X and Y, on the plane z = 0.

    Returns
    -------
    directions : (texel, light, 3)
        Unit vectors.
    factor : (texel, light)
        Irradiance of a surface that faces the lamp, over that at the centre: the square of the distances' ratio.
    """
    at = np.concatenate([points, np.zeros((len(points), 1))], 1)
    towards = positions[None] - at[:, None]
    distance = np.linalg.norm(towards, axis=2)
    return towards / distance[..., None], (np.linalg.norm(positions, axis=1) / distance) ** 2


def texel_points(height: int, width: int, texel_mm: float) -> Array:
    """Millimetres (texel, 2) from the field's centre of the texels of a map, rows from v = 0."""
    y, x = np.mgrid[:height, :width].astype(float)
    return texel_mm * np.stack([x.ravel() - (width - 1) / 2, y.ravel() - (height - 1) / 2], 1)


def matters(positions: Array, points: Array) -> bool:
    """Whether the directions turn over the field by more than a cell allows."""
    return bool(np.ptp(points, axis=0).max() > 2 * CELL * np.linalg.norm(positions, axis=1).min())


def fit(
    T: Samples,
    W: Samples,
    positions: Array,
    points: Array,
    tail: str = "ggx",
    lobes: int = 1,
    priors: list[Prior] | None = None,
    region: NDArray[np.intp] | None = None,
    threads: int = 1,
) -> SlopeFit:
    """`kinran.fit.slope.fit` under point lamps; the texels of a cell share directions, each has its irradiance.

    The view stays N. Parameters as there, `positions` and `points` as of `illumination`.
    """
    side = 2 * CELL * np.linalg.norm(positions, axis=1).min()
    _, cell = np.unique(np.round(points / side).astype(int), axis=0, return_inverse=True)
    size = LOBE_SIZE * lobes + DIFFUSE_SIZE
    P, C, F = np.zeros((len(T), size)), np.zeros((len(T), lobes + 1, 3)), np.zeros(len(T))
    for k in range(cell.max() + 1):
        at = np.flatnonzero(cell.ravel() == k)
        directions, _ = illumination(positions, points[at].mean(0, keepdims=True))
        _, factor = illumination(positions, points[at])
        even = np.asarray(T[at] / factor[:, None], np.float32)
        inside = None if region is None else region[at]
        part = slope.fit(even, W[at], directions[0], tail, lobes, priors, inside, threads)
        P[at], C[at], F[at] = part.shapes, part.colours, part.cost
    return SlopeFit(P, C, F)
