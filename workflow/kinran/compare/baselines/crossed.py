"""Facets of two threads that cross: orthogonal normals with a Fresnel factor [Takeda2005, Takeda2006].

Takeda2008, §3.2 says that a woven fabric "can also be considered to have an orthogonal normal vector distribution"
and names Takeda2005 ("using fresnel factor") and Takeda2006 for it; neither formula is in the paper. This is the least
that the words ask for: the normals of a thread along X spread in Y and the other way round, each family with a
Gaussian in half-vector slopes whose axes are those of the weave, times Schlick's Fresnel factor, and a diffuse term:

    T_c = Σ_k C_k,c F(θ_h) exp(-(d_x / a_k)² - (d_y / b_k)²) + C_d,c cos θ_i,   b₁ ≥ a₁, a₂ ≥ b₂.

At V = N the factor is all but constant: under light at 80° from the normal, half vectors at 40°, it is 1.02.
"""

import math

import numpy as np
from numpy.typing import NDArray

from kinran.compare.baselines import separable
from kinran.compare.baselines.separable import SeparableFit
from kinran.fit.samples import Samples

Array = NDArray[np.float64]

REFLECTANCE = 0.04
"""Reflectance at normal incidence of a dielectric of index 1.5, (0.5 / 2.5)²: silk. Gold's factor varies less."""
LOW, HIGH = np.array([-1.2, -1.2, math.log(0.03), 0.0]), np.array([1.2, 1.2, math.log(1.0), math.log(8.0)])
"""Bounds of a shape: centres at half vectors of up to 50° (the paper's lights reach 40°), widths in slope from 0.03 (a
step of the paper's grid is 0.044) to 1, and ratios of widths up to 8. They keep the solver from lobes that no light
shows; no fit was compared under others."""
WIDTH, RATIO = 0.15, 2.0
"""Narrow width in slope and ratio of widths from which every texel starts, in the middle of the bounds. No other start
was compared."""


def fit(samples: Samples) -> SeparableFit:
    """Fit every texel on its own, both families from the brightest sample's half vector."""
    slopes = samples.under.slopes[samples.under.cell, separable.brightest(samples)]
    widths = np.broadcast_to([math.log(WIDTH), math.log(RATIO)], (len(samples), 2))
    start = np.concatenate([slopes, widths], 1)
    return separable.fit(families, np.stack([start, start], 1), samples, LOW, HIGH)


def families(p: Array, slopes: Array, _lights: Array) -> tuple[Array, Array]:
    """Values (2n, light) of shapes (2n, 4), the two families in turn, and their derivatives (2n, 4, light)."""
    first = (np.arange(len(p)) % 2 == 0)[:, None]
    x, y = slopes.T
    narrow, wide = np.exp(p[:, 2:3]), np.exp(p[:, 2:3] + p[:, 3:])
    a, b = np.where(first, narrow, wide), np.where(first, wide, narrow)
    u, v = (x - p[:, :1]) / a, (y - p[:, 1:2]) / b
    G = fresnel(slopes) * np.exp(-u * u - v * v)
    stretched = np.where(first, v * v, u * u)
    return G, 2 * G[:, None] * np.stack([u / a, v / b, u * u + v * v, stretched], 1)


def fresnel(slopes: Array) -> Array:
    """Schlick's factor (light,) of facets of these slopes, over that at normal incidence (Schlick1994, Eq. 15)."""
    cosine = 1 / np.sqrt(1 + (slopes**2).sum(1))
    return np.asarray(1 + (1 / REFLECTANCE - 1) * (1 - cosine) ** 5)
