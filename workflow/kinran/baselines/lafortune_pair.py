"""Two generalised cosine lobes and a diffuse term at each texel [Filip2004, Lafortune1997].

T_c = Σ_k C_k,c max(0, L · d_k)^e_k + C_d,c cos θ_i. The first lobe starts from the fit of one, the second at the
brightest sample that this leaves.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.baselines import lafortune
from kinran.fit import separable

Samples = NDArray[np.float32]
Array = NDArray[np.float64]

EXPONENT = 15.0
"""Exponent from which the second lobe starts: it falls to half at 17°, for what a sharp first lobe leaves. No other
start was compared."""


@dataclass(frozen=True)
class LafortunePair:
    """Shapes (texel, 2, 3) p₀, p₁, ln e, and colours (texel, 3, 3) of the lobes and the diffuse term."""

    shapes: Array
    colours: Array
    numbers: int = 15
    shared: int = 0


def fit(T: Samples, W: Samples, lights: Array) -> LafortunePair:
    """Fit every texel on its own.

    Parameters
    ----------
    T : (texel, 3, light) float32
    W : (texel, light) float32
        Weights; 0 leaves a sample out.
    lights : (light, 3) float
    """
    one = lafortune.fit(T, lights)
    left = np.where(W > 0, (T - lafortune.predict(one, lights)).mean(1), -np.inf)
    towards = lights[left.argmax(1)]
    second = towards[:, :2] / np.maximum(towards[:, 2:], 0.05)
    start = np.stack([one.shapes, np.column_stack([second, np.full(len(T), math.log(EXPONENT))])], 1)
    low, high = np.array(lafortune.LOW), np.array(lafortune.HIGH)
    found = separable.fit(lambda p: lobe(p, lights), start, T, W, lights[:, 2], low, high)
    return LafortunePair(found.shapes, found.colours)


def predict(fitted: LafortunePair, lights: Array) -> Samples:
    """Samples (texel, 3, light) under other lights."""
    G = np.stack([lobe(fitted.shapes[:, k], lights)[0] for k in range(2)], 1)
    return separable.predict(G, fitted.colours, lights[:, 2])


def lobe(p: Array, lights: Array) -> tuple[Array, Array]:
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
