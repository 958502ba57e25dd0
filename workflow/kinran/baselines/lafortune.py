"""One generalised cosine lobe and a diffuse term at each texel [Filip2004, Lafortune1997].

With the view fixed, C_x, C_y and C_z of Lafortune's lobe are one direction d ∝ (p₀, p₁, 1) and a size:
T_c = C_s,c max(0, L · d)^e + C_d,c cos θ_i. The shape (p₀, p₁, ln e) is fitted to the luminance by variable
projection and Levenberg-Marquardt, the colours by non-negative least squares at its end.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Samples = NDArray[np.float32]
Array = NDArray[np.float64]

SIZE = 3
"""Numbers of a shape: p₀, p₁, ln e."""
LOW, HIGH = (-4.0, -4.0, 0.0), (4.0, 4.0, math.log(2000.0))
"""Bounds of a shape: lobes up to 76° from the normal, and exponents up to 2000, whose lobes fall to half within 1.5° (a
step of the paper's grid is 5°). They keep the solver from lobes that no light shows; no fit was compared under
others."""
ITERATIONS, TRIES, TOLERANCE = 25, 6, 1e-5
"""Steps, dampings that a step tries, and relative gain below which a texel is done: meant to stop where the error no
longer changes in the digits that the chart prints. No measurement stands behind them."""


@dataclass(frozen=True)
class Lafortune:
    """Shapes (texel, 3) p₀, p₁, ln e, and colours (texel, 2, 3) C_s, C_d."""

    shapes: Array
    colours: Array
    numbers: int = 9
    shared: int = 0


def fit(T: Samples, lights: Array) -> Lafortune:
    """Fit every texel on its own.

    Parameters
    ----------
    T : (texel, 3, light) float32
    lights : (light, 3) float
    """
    shapes, colours = np.zeros((len(T), SIZE)), np.zeros((len(T), 2, 3))
    _fit(T, np.ascontiguousarray(lights, float), np.array(LOW), np.array(HIGH), shapes, colours)
    return Lafortune(shapes, colours)


def predict(fitted: Lafortune, lights: Array) -> Samples:
    """Samples (texel, 3, light) under other lights."""
    axis = np.concatenate([fitted.shapes[:, :2], np.ones((len(fitted.shapes), 1))], 1)
    cosine = np.maximum(axis @ lights.T / np.linalg.norm(axis, axis=1, keepdims=True), 0)
    lobe = cosine ** np.exp(fitted.shapes[:, 2:])
    T = fitted.colours[:, 0, :, None] * lobe[:, None] + fitted.colours[:, 1, :, None] * lights[:, 2]
    return np.asarray(T, np.float32)


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator,unused-ignore]
def _nonnegative(gg: float, gl: float, ll: float, gy: float, ly: float) -> tuple[float, float]:
    """Minimiser of |y - a g - b l|² over a, b ≥ 0."""
    det = gg * ll - gl * gl
    if det > 1e-12 * gg * ll:
        a, b = (gy * ll - ly * gl) / det, (ly * gg - gy * gl) / det
        if a >= 0.0 and b >= 0.0:
            return a, b
    alone, other = max(gy, 0.0) / max(gg, 1e-30), max(ly, 0.0) / max(ll, 1e-30)
    if alone * max(gy, 0.0) > other * max(ly, 0.0):
        return alone, 0.0
    return 0.0, other


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator,unused-ignore]
def _project(p: Array, y: Array, lights: Array, G: Array, D: Array) -> tuple[float, float, float]:
    """Best amplitudes for a shape and the squared residual; fills G (n,) and its derivatives D (n, 3)."""
    norm = math.sqrt(1.0 + p[0] * p[0] + p[1] * p[1])
    power = math.exp(p[2])
    gg = gl = ll = gy = ly = yy = 0.0
    for i in range(y.size):
        z = lights[i, 2]
        c = (lights[i, 0] * p[0] + lights[i, 1] * p[1] + z) / norm
        if c > 1e-6:
            G[i] = c**power
            slope = power * G[i] / c
            D[i, 0] = slope * (lights[i, 0] - c * p[0] / norm) / norm
            D[i, 1] = slope * (lights[i, 1] - c * p[1] / norm) / norm
            D[i, 2] = power * G[i] * math.log(c)
        else:
            G[i] = D[i, 0] = D[i, 1] = D[i, 2] = 0.0
        gg += G[i] * G[i]
        gl += G[i] * z
        ll += z * z
        gy += G[i] * y[i]
        ly += z * y[i]
        yy += y[i] * y[i]
    a, b = _nonnegative(gg, gl, ll, gy, ly)
    return a, b, yy - 2 * (a * gy + b * ly) + a * a * gg + 2 * a * b * gl + b * b * ll


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator,unused-ignore]
def _normal(a: float, b: float, y: Array, lights: Array, G: Array, D: Array) -> tuple[Array, Array]:
    """Projected normal matrix (3, 3) and gradient (3,), as Kaufman simplifies them [Kaufman1975]."""
    H, X, g = np.zeros((SIZE, SIZE)), np.zeros((2, SIZE)), np.zeros(SIZE)
    A = np.zeros((2, 2))
    for i in range(y.size):
        z = lights[i, 2]
        rest = y[i] - a * G[i] - b * z
        A[0, 0] += G[i] * G[i]
        A[0, 1] += G[i] * z
        A[1, 1] += z * z
        for k in range(SIZE):
            X[0, k] += G[i] * D[i, k]
            X[1, k] += z * D[i, k]
            g[k] += a * D[i, k] * rest
            for j in range(SIZE):
                H[k, j] += D[i, k] * D[i, j]
    A[1, 0] = A[0, 1]
    A[0, 0] += 1e-9 * A[0, 0] + 1e-14
    A[1, 1] += 1e-9 * A[1, 1] + 1e-14
    return a * a * (H - X.T @ np.linalg.solve(A, X)), g


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator,unused-ignore]
def _fit(T: Samples, lights: Array, low: Array, high: Array, shapes: Array, colours: Array) -> None:
    n = lights.shape[0]
    y, G, D = np.empty(n), np.empty(n), np.empty((n, SIZE))
    for t in range(T.shape[0]):
        best = 0
        for i in range(n):
            y[i] = (float(T[t, 0, i]) + float(T[t, 1, i]) + float(T[t, 2, i])) / 3.0
            if y[i] > y[best]:
                best = i
        p = shapes[t]
        z = max(lights[best, 2], 0.05)
        p[0], p[1], p[2] = lights[best, 0] / z, lights[best, 1] / z, math.log(15.0)
        p[:] = np.minimum(np.maximum(p, low), high)
        a, b, cost = _project(p, y, lights, G, D)
        damping = 1e-2
        for _ in range(ITERATIONS):
            H, g = _normal(a, b, y, lights, G, D)
            gain = 0.0
            for _try in range(TRIES):
                damped = H.copy()
                for k in range(SIZE):
                    damped[k, k] += damping * H[k, k] + 1e-12 * (1.0 + H[k, k])
                step = np.minimum(np.maximum(np.linalg.solve(damped, g), -1.0), 1.0)
                trial = np.minimum(np.maximum(p + step, low), high)
                a, b, new = _project(trial, y, lights, G, D)
                if new < cost:
                    gain = (cost - new) / max(cost, 1e-30)
                    p[:] = trial
                    cost = new
                    damping = max(damping * 0.2, 1e-9)
                    break
                damping *= 6.0
            if gain < TOLERANCE:
                break
        _project(p, y, lights, G, D)
        for c in range(3):
            gg = gl = ll = gy = ly = 0.0
            for i in range(n):
                z = lights[i, 2]
                gg += G[i] * G[i]
                gl += G[i] * z
                ll += z * z
                gy += G[i] * T[t, c, i]
                ly += z * T[t, c, i]
            colours[t, 0, c], colours[t, 1, c] = _nonnegative(gg, gl, ll, gy, ly)
