"""Lobes of any formula fitted to many texels at once: the comparisons of the chart, not the pipeline's solver.

T_c = Σ_k C_k,c G_k(light; p_k) + C_d,c cos θ_i with C ≥ 0. The colours are eliminated by non-negative least squares,
the shapes found by Levenberg-Marquardt with Kaufman's projected Jacobian.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Lobe = Callable[[Array], tuple[Array, Array]]
"""Shapes (texel, K) to values (texel, light) and derivatives (texel, K, light)."""

ITERATIONS = 40
TOLERANCE = 1e-5
RIDGE = 1e-9
BLOCK = 256


@dataclass(frozen=True)
class SeparableFit:
    """Shapes (texel, lobes, K), colours (texel, lobes + 1, 3) and weighted squared residual (texel,)."""

    shapes: Array
    colours: Array
    cost: Array


def fit(
    lobe: Lobe, start: Array, T: NDArray[np.float32], W: NDArray[np.float32], cosine: Array, low: Array, high: Array
) -> SeparableFit:
    """Fit from a start.

    Parameters
    ----------
    lobe
        The formula.
    start : (texel, lobes, K) float
        Shapes to start from.
    T, W : (texel, 3, light), (texel, light) float32
        Samples and weights; 0 leaves a sample out.
    cosine : (light,) float
        cos θ_i.
    low, high : (K,) float
        Bounds of the shapes.
    """
    parts = []
    for at in range(0, len(T), BLOCK):
        block = slice(at, at + BLOCK)
        w = np.where(np.isfinite(T[block]).all(1), W[block], 0).astype(float)
        y = np.where(w[:, None] > 0, T[block], 0).astype(float)
        parts.append(_descend(lobe, np.clip(start[block], low, high), y, w, cosine, low, high))
    return SeparableFit(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def predict(G: Array, colours: Array, cosine: Array) -> NDArray[np.float32]:
    """Samples (texel, 3, light) of lobes with values G (texel, lobes, light), as `fit` has colours and cosines."""
    total = colours[:, -1, :, None] * cosine
    for k in range(G.shape[1]):
        total += colours[:, k, :, None] * G[:, k, None]
    return np.asarray(total, np.float32)


def _descend(
    lobe: Lobe, p: Array, y: Array, w: Array, cosine: Array, low: Array, high: Array
) -> tuple[Array, Array, Array]:
    """Each texel has its own damping; one that is done stays where it is."""
    G, D = _columns(lobe, p, cosine)
    C, cost = _colours(G, y, w)
    damping, active = np.full(len(p), 1e-2), np.ones(len(p), bool)
    for _ in range(ITERATIONS):
        H, g = _normal_equations(G, D, C, y, w)
        diagonal = np.einsum("tkk->tk", H)
        damped = H + np.eye(H.shape[1]) * (diagonal * damping[:, None] + 1e-12 * (1 + diagonal))[:, None]
        step = np.clip(np.linalg.solve(damped, g[..., None])[..., 0], -1, 1)
        trial = np.clip(p + step.reshape(p.shape), low, high)
        G_new, D_new = _columns(lobe, trial, cosine)
        C_new, cost_new = _colours(G_new, y, w)
        better = active & (cost_new < cost)
        done = better & (cost - cost_new < TOLERANCE * cost)
        p, C = np.where(better[:, None, None], trial, p), np.where(better[:, None, None], C_new, C)
        G, D = np.where(better[:, None, None], G_new, G), np.where(better[:, None, None, None], D_new, D)
        cost = np.where(better, cost_new, cost)
        damping = np.where(better, np.maximum(0.2 * damping, 1e-9), 6 * damping)
        active &= ~done & (damping < 1e6)
        if not active.any():
            break
    return p, C, cost


def _columns(lobe: Lobe, p: Array, cosine: Array) -> tuple[Array, Array]:
    """Values (texel, lobes + 1, light), the cosine last, and derivatives (texel, lobes, K, light)."""
    texels, lobes, size = p.shape
    g, d = lobe(p.reshape(-1, size))
    values = np.empty((texels, lobes + 1, len(cosine)))
    values[:, :lobes], values[:, lobes] = g.reshape(texels, lobes, -1), cosine
    return values, d.reshape(texels, lobes, size, -1)


def _colours(G: Array, y: Array, w: Array) -> tuple[Array, Array]:
    """Non-negative least squares by trying every active set; colours (texel, columns, 3) and cost (texel,)."""
    columns = G.shape[1]
    A = np.einsum("tan,tn,tbn->tab", G, w, G, optimize=True)
    b = np.einsum("tan,tn,tcn->tac", G, w, y, optimize=True)
    best, C = np.zeros((len(G), 3)), np.zeros_like(b)
    for mask in range(1, 1 << columns):
        use = [k for k in range(columns) if mask >> k & 1]
        sub = A[:, use][:, :, use] * (1 + RIDGE * np.eye(len(use))) + 1e-14 * np.eye(len(use))
        x = np.linalg.solve(sub, b[:, use])
        value = -(x * b[:, use]).sum(1)
        take = (x >= 0).all(1) & (value < best)
        best = np.where(take, value, best)
        full = np.zeros_like(b)
        full[:, use] = x
        C = np.where(take[:, None], full, C)
    return C, np.maximum(np.einsum("tcn,tn->t", y**2, w) + best.sum(1), 0)


def _normal_equations(G: Array, D: Array, C: Array, y: Array, w: Array) -> tuple[Array, Array]:
    """Projected normal matrix (texel, lobes·K, lobes·K) and gradient (texel, lobes·K)."""
    texels, lobes, size, _ = D.shape
    flat = D.reshape(texels, lobes * size, -1)
    wD = flat * w[:, None]
    rest = y - np.einsum("tac,tan->tcn", C, G)
    owner = np.repeat(C[:, :lobes], size, axis=1)
    g = np.einsum("tkc,tkn,tcn->tk", owner, wD, rest, optimize=True)
    held = (C.sum(2) > 0)[..., None]
    A = np.einsum("tan,tn,tbn->tab", G, w, G, optimize=True)
    A = np.where(held & held.swapaxes(1, 2) | np.eye(A.shape[1], dtype=bool), A, 0)
    A = A * (1 + RIDGE * np.eye(A.shape[1])) + 1e-14 * np.eye(A.shape[1])
    X = np.where(held, np.einsum("tan,tkn->tak", G, wD, optimize=True), 0)
    H = np.einsum("tkn,tjn->tkj", wD, flat, optimize=True) - np.einsum("tak,taj->tkj", X, np.linalg.solve(A, X))
    return H * np.einsum("tkc,tjc->tkj", owner, owner), g
