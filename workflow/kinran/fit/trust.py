"""Find what not to trust in a set: lights that do not fit in with their neighbours, and samples that are outliers.

Lobes are no exact model, and their residual is not noise: a robust loss everywhere would cost more than it gains. But
their residual is as smooth over the lights as a highlight is. A light that stands elsewhere than its list says, or
flickered, has larger residuals than its neighbours in most texels; an outlier has them in its own texel.
"""

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.fit import robust_weights, slope
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes

Array = NDArray[np.float64]
Single = NDArray[np.float32]

NEIGHBOURS = 6
"""Number of neighbours that a light is compared with: a ring around it. A choice."""
ODD = 2.0
"""Residual of a light, over that of its neighbours, from which it loses weight (docs/fit.md, "Robust weights")."""
ROUNDS = 2
"""Fits after which lights lose weight; the second is made without what the first left out. A choice."""
BETTER = 0.4
"""Smoothed squared residual of Huber's fit, over that of least squares, under which all texels take Huber's loss
(docs/fit.md, "Robust weights")."""


def learn(samples: Samples, lobes: Lobes, threads: int) -> tuple[Single, bool]:
    """Learn which lights to trust and whether samples are outliers, from free fits to a sample of texels.

    Returns
    -------
    factors : (light,) float32
        Factor of the weights of each light's samples.
    outliers : bool
        Whether Huber's loss is better than least squares.
    """
    s = frames.slopes(samples.under.directions)
    near = frames.nearest(s, NEIGHBOURS + 1)[1]
    factors = np.ones(len(s), np.float32)
    if len(s) <= NEIGHBOURS or not len(samples):
        return factors, False
    free = slope.fit(samples, lobes, threads=threads)
    for _ in range(ROUNDS):
        found = np.minimum(1, (ODD / oddness(_left(samples, free), near)) ** 2).astype(np.float32)
        if (found == factors).all():
            break
        factors = found
        free = slope.fit(samples.weighed(factors), lobes, threads=threads)
    samples = samples.weighed(factors)
    huber, _ = robust_weights.robust(samples, lobes, threads=threads)
    smooth = [_smooth(_left(samples, fitted), samples.W, near) for fitted in (huber, free)]
    return factors, bool(smooth[0] < BETTER * smooth[1])


def oddness(left: Array, near: NDArray[np.intp]) -> Array:
    """Residual (light,) of each light, in the median of the texels, over that of its neighbours.

    Parameters
    ----------
    left : (texel, light)
        Size of residuals; NaN where a sample is not used.
    near : (light, k) int
        Each light and its neighbours.
    """
    own = np.nanmedian(left / np.maximum(np.nanmedian(left, 1, keepdims=True), 1e-12), 0)
    return np.asarray(own / np.maximum(np.median(own[near[:, 1:]], 1), 1e-12))


def _left(samples: Samples, fitted: SlopeFit) -> Array:
    """Size (texel, light) of the residuals of a fit; NaN where a sample is not used."""
    size = np.linalg.norm(np.nan_to_num(samples.T) - fitted.predict(samples.under), axis=1)
    return np.where(samples.W > 0, size, np.nan)


def _smooth(left: Array, W: Single, near: NDArray[np.intp]) -> float:
    """Weighted sum of the squares of residuals, each replaced by the median of its neighbourhood."""
    known = np.nan_to_num(left)
    return float((W * np.median(known[:, near], 2) ** 2).sum())
