"""Generalised cosine lobes and a diffuse term at each texel [Filip2004, Lafortune1997]: one lobe, or two.

With the view fixed, C_x, C_y and C_z of Lafortune's lobe are one direction d ∝ (p₀, p₁, 1) and a size:
T_c = Σ_k C_k,c max(0, L · d_k)^e_k + C_d,c cos θ_i. The shapes are (p₀, p₁, ln e).
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinran.compare.baselines import separable
from kinran.compare.baselines.separable import SeparableFit
from kinran.fit.samples import Samples

Array = NDArray[np.float64]

LOW, HIGH = np.array([-4.0, -4.0, 0.0]), np.array([4.0, 4.0, math.log(2000.0)])
"""Bounds of the shapes: directions up to 80° from N, exponents from that of the diffuse term to lobes of 2°."""
EXPONENT = 15.0
"""Exponent to start from. A choice, between those of silk and of gold."""
LEAST_COSINE = 0.05
"""Least cosine of the direction that a lobe's search starts from, which keeps it off the horizon. A choice."""


def one(samples: Samples) -> SeparableFit:
    """Fit one lobe to every texel on its own, from its brightest sample: the shape to luminance, then the colours."""
    luminance = replace(samples, T=samples.T.mean(1, keepdims=True))
    shapes = _fit(towards(samples)[:, None], luminance).shapes
    return _fit(shapes, samples, iterations=0)


def two(samples: Samples) -> SeparableFit:
    """Fit two lobes: the first from the fit of one, the second from the brightest sample that this leaves."""
    first = one(samples)
    left = replace(samples, T=samples.T - first.predict(samples.under))
    return _fit(np.stack([first.shapes[:, 0], towards(left)], 1), samples)


def _fit(start: Array, samples: Samples, iterations: int = separable.ITERATIONS) -> SeparableFit:
    return separable.fit(lobe, start, samples, LOW, HIGH, iterations)


def towards(samples: Samples) -> Array:
    """Shapes (texel, 3) of a lobe at each texel's brightest sample."""
    light = samples.under.lights[samples.under.cell, separable.brightest(samples)]
    exponent = np.full(len(samples), math.log(EXPONENT))
    return np.column_stack([light[:, :2] / np.maximum(light[:, 2:], LEAST_COSINE), exponent])


def lobe(p: Array, _slopes: Array, lights: Array) -> tuple[Array, Array]:
    """Values (n, light) of lobes p (n, 3), and their derivatives (n, 3, light)."""
    norm = np.sqrt(1 + p[:, :1] ** 2 + p[:, 1:2] ** 2)
    cosine = (p[:, :2] @ lights[:, :2].T + lights[:, 2]) / norm
    seen = cosine > 1e-6
    c = np.where(seen, cosine, 1.0)
    power = np.exp(p[:, 2:])
    G = np.where(seen, c**power, 0.0)
    slope = power * G / c
    along = [slope * (lights[:, k] - c * p[:, k : k + 1] / norm) / norm for k in range(2)]
    return G, np.stack([*along, power * G * np.log(c)], 1)
