"""Lobes of any formula fitted to many texels at once: the comparisons of the chart, not the pipeline's solver.

T_c = Σ_k C_k,c G_k(light; p_k) + C_d,c cos θ_i with C ≥ 0. The colours are eliminated by non-negative least squares,
the shapes found by Levenberg-Marquardt with the projected Jacobian of Kaufman1975.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples
from kinran.fit.solver.linear import RIDGE, nonnegative

Single = NDArray[np.float32]
Array = NDArray[np.float64]
Formula = Callable[[Array, Array, Array], tuple[Array, Array]]
"""Function from shapes (n, K), slopes of half vectors (light, 2) and lights (light, 3) to the values (n, light) of
lobes and their derivatives (n, K, light)."""

ITERATIONS = 40
"""Most iterations of a search. A choice; no command compares other numbers."""
TOLERANCE = 1e-5
"""Share of the cost that a step has to gain for a texel's search to go on. A choice."""
DAMPING, EASIER, HARDER = 1e-2, 0.2, 6.0
"""Damping of Levenberg-Marquardt at the start, and its factors after steps that gained or did not. Choices."""
FUTILE = 1e6
"""Damping from which on no step gains. A choice."""
TINY = 1e-14
"""Ridge of normal matrices beside `RIDGE` times their diagonal, for lobes that see no light. A choice."""
BLOCK = 256
"""Texels that are fitted together, with all of their derivatives in memory; results do not depend on it."""


@dataclass(frozen=True)
class SeparableFit:
    """Lobes and a diffuse term at each texel.

    Attributes
    ----------
    formula
        The lobes' formula.
    shapes : (texel, lobes, K) float64
    colours : (texel, lobes + 1, 3) float64
        Colours of the lobes and of the diffuse term.
    """

    formula: Formula
    shapes: Array
    colours: Array
    shared: int = 0

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return float(np.prod(self.shapes.shape[1:]) + np.prod(self.colours.shape[1:]))

    def predict(self, under: Under) -> Single:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        T = np.empty((len(self.shapes), 3, under.count), np.float32)
        for cell, block in _blocks(under, len(T)):
            G, _ = _columns(self.formula, self.shapes[block], under.slopes[cell], under.lights[cell])
            T[block] = np.einsum("tac,tan->tcn", self.colours[block], G)
        return T


def fit(
    formula: Formula, start: Array, samples: Samples, low: Array, high: Array, iterations: int = ITERATIONS
) -> SeparableFit:
    """Fit lobes of a formula and a diffuse term to each texel, from a start.

    Parameters
    ----------
    start : (texel, lobes, K) float
        Shapes to start from.
    samples
        Samples; those that are not finite or have no weight are left out.
    low, high : (K,) float
        Bounds of the shapes.
    iterations
        At most; none leaves the shapes as they are and finds their colours.
    """
    shapes = np.clip(start, low, high)
    colours = np.empty((len(samples), start.shape[1] + 1, samples.T.shape[1]))
    for cell, block in _blocks(samples.under, len(samples)):
        T, W = samples.T[block], samples.W[block]
        w = np.where(np.isfinite(T).all(1), W, 0).astype(float)
        y = np.where(w[:, None] > 0, T, 0).astype(float)
        part = _Block(formula, samples.under.slopes[cell], samples.under.lights[cell], y, w)
        shapes[block], colours[block] = _descend(part, shapes[block], low, high, iterations)
    return SeparableFit(formula, shapes, colours)


def brightest(samples: Samples) -> NDArray[np.intp]:
    """Light (texel,) of the brightest sample that counts: where a lobe's search starts."""
    return np.asarray(np.where(samples.W > 0, samples.T.mean(1), -np.inf).argmax(1))


def _blocks(under: Under, texels: int) -> list[tuple[int, NDArray[np.intp]]]:
    """Texels of one cell, as many as are fitted together: the cell, and their places."""
    found = []
    for cell, at in under.cells():
        places = np.arange(texels)[at]
        found += [(cell, places[k : k + BLOCK]) for k in range(0, len(places), BLOCK)]
    return found


@dataclass(frozen=True)
class _Block:
    """Texels of one cell: samples y (texel, channel, light) and their weights w (texel, light)."""

    formula: Formula
    slopes: Array
    lights: Array
    y: Array
    w: Array

    def columns(self, p: Array) -> tuple[Array, Array]:
        """Values (texel, lobes + 1, light), the cosine last, and derivatives (texel, lobes, K, light)."""
        return _columns(self.formula, p, self.slopes, self.lights)

    def colours(self, G: Array) -> tuple[Array, Array]:
        """Non-negative least squares: colours (texel, columns, channel), and the cost (texel,) that they leave."""
        A = np.einsum("tan,tn,tbn->tab", G, self.w, G, optimize=True)
        b = np.einsum("tan,tn,tcn->tca", G, self.w, self.y, optimize=True)
        C, gain = np.zeros_like(b), np.zeros(len(G))
        _nonnegative(A, b, C, gain)
        return C.transpose(0, 2, 1), np.maximum(np.einsum("tcn,tn->t", self.y**2, self.w) + gain, 0)

    def normal_equations(self, G: Array, D: Array, C: Array) -> tuple[Array, Array]:
        """Projected normal matrix (texel, lobes·K, lobes·K) and gradient (texel, lobes·K)."""
        texels, lobes, size, _ = D.shape
        flat = D.reshape(texels, lobes * size, -1)
        wD = flat * self.w[:, None]
        rest = self.y - np.einsum("tac,tan->tcn", C, G)
        owner = np.repeat(C[:, :lobes], size, axis=1)
        g = np.einsum("tkc,tkn,tcn->tk", owner, wD, rest, optimize=True)
        held = (C.sum(2) > 0)[..., None]
        A = np.einsum("tan,tn,tbn->tab", G, self.w, G, optimize=True)
        A = np.where(held & held.swapaxes(1, 2) | np.eye(A.shape[1], dtype=bool), A, 0)
        A = A * (1 + RIDGE * np.eye(A.shape[1])) + TINY * np.eye(A.shape[1])
        X = np.where(held, np.einsum("tan,tkn->tak", G, wD, optimize=True), 0)
        H = np.einsum("tkn,tjn->tkj", wD, flat, optimize=True) - np.einsum("tak,taj->tkj", X, np.linalg.solve(A, X))
        return H * np.einsum("tkc,tjc->tkj", owner, owner), g


def _columns(formula: Formula, p: Array, slopes: Array, lights: Array) -> tuple[Array, Array]:
    """Values and derivatives of shapes (texel, lobes, K) as `_Block.columns` has them."""
    texels, lobes, size = p.shape
    g, d = formula(p.reshape(-1, size), slopes, lights)
    values = np.empty((texels, lobes + 1, len(lights)))
    values[:, :lobes], values[:, lobes] = g.reshape(texels, lobes, -1), lights[:, 2]
    return values, d.reshape(texels, lobes, size, -1)


def _descend(block: _Block, p: Array, low: Array, high: Array, iterations: int) -> tuple[Array, Array]:
    """Shapes and colours; each texel has its own damping, and one that is done stays where it is."""
    G, D = block.columns(p)
    C, cost = block.colours(G)
    damping, active = np.full(len(p), DAMPING), np.ones(len(p), bool)
    for _ in range(iterations):
        H, g = block.normal_equations(G, D, C)
        diagonal = np.einsum("tkk->tk", H)
        damped = H + np.eye(H.shape[1]) * (diagonal * damping[:, None] + 1e-12 * (1 + diagonal))[:, None]
        step = np.clip(np.linalg.solve(damped, g[..., None])[..., 0], -1, 1)
        trial = np.clip(p + step.reshape(p.shape), low, high)
        G_new, D_new = block.columns(trial)
        C_new, cost_new = block.colours(G_new)
        better = active & (cost_new < cost)
        done = better & (cost - cost_new < TOLERANCE * cost)
        p, C = np.where(better[:, None, None], trial, p), np.where(better[:, None, None], C_new, C)
        G, D = np.where(better[:, None, None], G_new, G), np.where(better[:, None, None, None], D_new, D)
        cost = np.where(better, cost_new, cost)
        damping = np.where(better, np.maximum(EASIER * damping, 1e-9), HARDER * damping)
        active &= ~done & (damping < FUTILE)
        if not active.any():
            break
    return p, C


@njit(cache=True, nogil=True)  # type: ignore[untyped-decorator,unused-ignore]
def _nonnegative(A: Array, b: Array, C: Array, gain: Array) -> None:
    """Write the x ≥ 0 of least xᵀAx - 2bᵀx of each texel and channel to C (texel, 3, m); add the least to `gain`."""
    texels, m = A.shape[:2]
    work = np.empty((2 * m + 3, m))
    for t in range(texels):
        for c in range(b.shape[1]):
            gain[t] += nonnegative(A[t], b[t, c], m, C[t, c], work)
