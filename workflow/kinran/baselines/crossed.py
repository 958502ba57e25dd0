"""Facets of two threads that cross: orthogonal normals with a Fresnel factor (TVST05, TT06, as far as they are told).

Takeda2008, §3.2 says that a woven fabric "can also be considered to have an orthogonal normal vector distribution"
and names TVST05 ("using fresnel factor") and TT06 for it; neither formula is in the paper. This is the least that
the words ask for: the normals of a thread along X spread in Y and the other way round, each family with a Gaussian in
half-vector slopes whose axes are those of the weave, times Schlick's Fresnel factor, and a diffuse term:

    T_c = Σ_k C_k,c F(θ_h) exp(-(d_x / a_k)² - (d_y / b_k)²) + C_d,c cos θ_i,   b₁ ≥ a₁, a₂ ≥ b₂.

At V = N the factor is all but constant: under light at 80° from the normal, half vectors at 40°, it is 1.02.
"""

import math

import numpy as np
from numpy.typing import NDArray

from kinran.baselines import separable
from kinran.baselines.separable import SeparableFit
from kinran.fit.samples import Samples

Array = NDArray[np.float64]

REFLECTANCE = 0.04
"""Reflectance of a dielectric at normal incidence: silk. Gold's factor varies less."""
LOW, HIGH = np.array([-1.2, -1.2, math.log(0.03), 0.0]), np.array([1.2, 1.2, math.log(1.0), math.log(8.0)])
"""Bounds of the shapes μ_x, μ_y, ln of the narrow width, ln of the ratio of widths: facets up to 50°, no lobe narrower
than the lights of the paper's grid tell. A choice."""
WIDTH, RATIO = 0.15, 2.0
"""Narrow width and ratio to start from. A choice."""


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
