"""The `slope` model fitted to a block of texels: bounds, weights, prior, threads."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS
from kinran.fit.varpro import fit_block, shape_count

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

ITERATIONS = 25
BLOCK = 256
MAX_SLOPE = 1.2
MAX_WIDTH = 2.0
PRIOR_SD = (0.3, 0.3, 0.35, 3.0, 0.35)
DIFFUSE_SD = 0.3
PRIOR_STRENGTH = 10.0


@dataclass(frozen=True)
class Prior:
    """A region's prior on the shapes of its texels.

    Attributes
    ----------
    centre : (K,) float
        Median shape of the region.
    variance
        Mean weighted squared residual of a sample: how far the model is from the data in this region.
    """

    centre: Array
    variance: float

    def stiffness(self) -> Array:
        """Weights ρ (K,) of Σ ρ_k (p_k - p̄_k)², so that directions that are many outvote it."""
        lobes = (self.centre.size - DIFFUSE_SIZE) // LOBE_SIZE
        sd = np.array(PRIOR_SD * lobes + (DIFFUSE_SD,) * DIFFUSE_SIZE)
        return PRIOR_STRENGTH * self.variance / sd**2


@dataclass(frozen=True)
class SlopeFit:
    """Result for a block of texels.

    Attributes
    ----------
    shapes : (texel, K) float64
        (μ_x, μ_y, α, β, γ) a lobe, then the slopes of the diffuse normal.
    colours : (texel, lobes + 1, 3) float64
        Amplitudes of the lobes and of the diffuse term, in the unit of the samples.
    cost : (texel,) float64
        Weighted squared residual.
    """

    shapes: Array
    colours: Array
    cost: Array


def resolution(lights: Array) -> float:
    """Smallest lobe width (1/e, in slopes) that light directions (n, 3) can tell from a needle between two.

    It is 0.6 of the median distance to the nearest other light in slope space, at least 0.02.
    """
    s = frames.slopes(lights)
    if len(s) < 2:
        return MAX_WIDTH / 2
    distance = np.linalg.norm(s[:, None] - s[None], axis=-1)
    np.fill_diagonal(distance, np.inf)
    return float(np.clip(0.6 * np.median(distance.min(1)), 0.02, MAX_WIDTH / 2))


def bounds(lights: Array, lobes: int) -> tuple[Array, Array]:
    """Lower and upper bounds (K,) of the shapes."""
    narrow, wide = -math.log(resolution(lights)), -math.log(MAX_WIDTH)
    low = [-MAX_SLOPE, -MAX_SLOPE, wide, -60.0, wide] * lobes + [-1.0] * DIFFUSE_SIZE
    high = [MAX_SLOPE, MAX_SLOPE, narrow, 60.0, narrow] * lobes + [1.0] * DIFFUSE_SIZE
    return np.array(low), np.array(high)


def fit(
    T: Samples,
    W: Samples,
    lights: Array,
    tail: str = "ggx",
    lobes: int = 1,
    priors: list[Prior] | None = None,
    region: NDArray[np.intp] | None = None,
    threads: int = 1,
) -> SlopeFit:
    """Fit lobes in slope space and a diffuse term to each texel.

    Parameters
    ----------
    T : (texel, 3, light) float32
        Radiance samples (T of DESIGN: f_r cos θ_i, in any unit).
    W : (texel, light) float32
        Sample weights; 0 for what is not to be used. Samples that are not finite get 0.
    lights : (light, 3) float
        Unit directions.
    tail
        ``gaussian`` or ``ggx``.
    lobes
        One or two.
    priors, region
        A prior for each region and the region (texel,) of each texel; without them every texel stands alone.
    threads
        Of the machine; the result does not depend on it.
    """
    count, n = len(T), len(lights)
    lights = np.ascontiguousarray(lights, float)
    s = np.ascontiguousarray(frames.slopes(lights))
    W = np.where(np.isfinite(T).all(1), W, 0).astype(np.float32)
    low, high = bounds(lights, lobes)
    size = shape_count(lobes)
    centre, stiffness = np.zeros((count, size)), np.zeros((count, size))
    if priors is not None and region is not None:
        centre = np.stack([p.centre for p in priors])[region]
        stiffness = np.stack([p.stiffness() for p in priors])[region]
    P, C, F = np.zeros((count, size)), np.zeros((count, lobes + 1, 3)), np.zeros(count)

    def block(start: int) -> None:
        at = slice(start, min(start + BLOCK, count))
        fit_block(
            TAILS[tail],
            lobes,
            T[at],
            W[at],
            s,
            lights,
            low,
            high,
            centre[at],
            stiffness[at],
            ITERATIONS,
            P[at],
            C[at],
            F[at],
        )

    assert T.shape == (count, 3, n)
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, range(0, count, BLOCK)))
    return SlopeFit(P, C, F)


def region_priors(fitted: SlopeFit, W: Samples, region: NDArray[np.intp], regions: int) -> list[Prior]:
    """Priors of regions from free fits of a sample of their texels: medians of shape and of residual."""
    priors = []
    samples = np.maximum((W > 0).sum(1) * 3.0, 1.0)
    for k in range(regions):
        inside = region == k
        priors.append(
            Prior(
                np.median(fitted.shapes[inside], 0),
                max(float(np.median(fitted.cost[inside] / samples[inside])), 1e-12),
            )
        )
    return priors
