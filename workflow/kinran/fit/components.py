"""The remainder that lobes leave of samples, in display-like values, and its principal components over the lights."""

import numpy as np
from numpy.typing import NDArray

from kinran_bsdf.residual import compress

Array = NDArray[np.float64]
Values = NDArray[np.float32]


def by_light(T: Values, domain: str) -> Values:
    """Display-like values (light, texel · 3) of radiance (texel, 3, light)."""
    return np.asarray(compress(T, domain).transpose(2, 0, 1).reshape(T.shape[2], -1))


def remainder(shown: Values, lobes: Values, domain: str, share: float) -> Values:
    """Samples less a share of the lobes, both (light, texel · 3) in display-like values.

    The remainder is 0 where a photograph is saturated and the lobes exceed it.
    """
    left = shown - np.float32(share) * lobes
    photograph = not domain.startswith("log:")
    return np.where((shown >= 1) & (left < 0), 0, left) if share == 1 and photograph else left


def principal(left: Values, count: int) -> Array:
    """Orthonormal factors (light, ≤ count) of the first principal components over lights."""
    return leading((left @ left.T).astype(float), count)


def leading(gram: Array, count: int) -> Array:
    """Eigenvectors (light, ≤ count) of a Gram matrix, those of the largest eigenvalues first."""
    values, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, np.argsort(values)[::-1][:count]])
