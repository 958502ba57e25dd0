"""Covariances of the parameters of a fit, from its Gauss-Newton Hessian."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Index
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.solver import hessian, prepare
from kinran.fit.solver.lobes import TAILS

Array = NDArray[np.float64]

BLOCK = 256
"""Texels that a thread takes at a time; the result does not depend on it."""


def covariances(fitted: SlopeFit, samples: Samples, stiffness: Array | None = None, threads: int = 1) -> Array:
    """Covariance matrix σ² (JᵀWJ + ρ)⁻¹ of the shapes and colours of each texel.

    σ² is the texel's own mean squared residual, so that misfit of the model counts as noise.

    Parameters
    ----------
    stiffness : (texel, K)
        Stiffness ρ of the prior; 0 without one.

    Returns
    -------
    (texel, K + 3 (lobes + 1), K + 3 (lobes + 1))
        Infinite on the diagonal where nothing fixes a parameter.
    """
    prepare()
    weights = np.where(np.isfinite(samples.T).all(1), samples.W, 0).astype(np.float32)
    P, C = np.ascontiguousarray(fitted.shapes, float), np.ascontiguousarray(fitted.colours, float)
    rho = np.zeros_like(P) if stiffness is None else np.ascontiguousarray(stiffness, float)
    total = P.shape[1] + 3 * C.shape[1]
    out = np.empty((len(P), total, total))
    tail, under = TAILS[fitted.lobes.tail], samples.under

    def block(job: tuple[int, NDArray[np.intp]]) -> None:
        cell, at = job
        part = np.empty((len(at), total, total))
        s, lights = under.slopes[cell], under.lights[cell]
        hessian.covariances(tail, P[at], C[at], samples.T[at], weights[at], s, lights, rho[at], part)
        out[at] = part

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, [job for cell, at in under.cells() for job in _blocks(cell, at, len(P))]))
    return out


def _blocks(cell: int, at: Index, texels: int) -> list[tuple[int, NDArray[np.intp]]]:
    """Blocks of a cell's texels: the cell, and the indices of the texels."""
    places = np.arange(texels)[at]
    return [(cell, places[k : k + BLOCK]) for k in range(0, len(places), BLOCK)]
