"""A mixture of Gaussians by expectation maximisation: the comparison for regions by Mahalanobis distance."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Labels = NDArray[np.intp]

ROUNDS = 40
"""Rounds of expectation maximisation, meant to be more than it needs; no measurement stands behind the number."""
RIDGE = 1e-4
"""Ridge of the covariances of features of unit spread, so that one of few texels has an inverse. A choice."""


def labels(features: Array, start: Labels, count: int) -> Labels:
    """Most probable component (texel,) of each texel in a mixture with full covariances.

    Parameters
    ----------
    features : (texel, d) float
    start : (texel,) int
        Labels to start from, such as those of k-means.
    count
        Number of components.
    """
    texels, d = features.shape
    share = np.eye(count)[start]
    for _ in range(ROUNDS):
        sizes = share.sum(0) + 1e-9
        score = np.empty((texels, count))
        for k in range(count):
            x = features - share[:, k] @ features / sizes[k]
            covariance = (x * share[:, k : k + 1]).T @ x / sizes[k] + RIDGE * np.eye(d)
            distance = np.einsum("ti,ti->t", x @ np.linalg.inv(covariance), x)
            score[:, k] = np.log(sizes[k] / texels) - 0.5 * (distance + np.linalg.slogdet(covariance)[1])
        share = np.exp(score - score.max(1, keepdims=True))
        share /= share.sum(1, keepdims=True)
    return np.asarray(share.argmax(1), np.intp)
