"""Principal components over the lights, interpolated between them [Schneider2004]."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.baselines.interpolation import Matrix

Samples = NDArray[np.float32]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Components:
    """Scores of each texel over shared components.

    Attributes
    ----------
    scores : (texel, k) float32
    components : (k, 3, light) float32
        Orthonormal.
    mean : (3, light) float32
    lights : (light, 3)
    matrix
        Interpolation of the components to other lights.
    """

    scores: Samples
    components: Samples
    mean: Samples
    lights: Array
    matrix: Matrix

    @property
    def numbers(self) -> int:
        """Numbers of a texel."""
        return int(self.scores.shape[1])

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return int(self.components.size + self.mean.size)


def fit(T: Samples, lights: Array, count: int, matrix: Matrix) -> Components:
    """The first `count` principal components of the texels' vectors (3 · light).

    Found from the smaller of the two Gram matrices, so that neither many texels nor many lights are dear.
    """
    texels, channels, n = T.shape
    X = T.reshape(texels, channels * n)
    mean = X.mean(0)
    X = X - mean
    count = min(count, texels, channels * n)
    if texels >= channels * n:
        gram = (X.T @ X).astype(float)
        _, vectors = np.linalg.eigh(gram)
        basis = vectors[:, ::-1][:, :count].astype(np.float32)
    else:
        values, vectors = np.linalg.eigh((X @ X.T).astype(float))
        scale = np.sqrt(np.maximum(values[::-1][:count], 1e-30))
        basis = ((X.T @ vectors[:, ::-1][:, :count]) / scale).astype(np.float32)
    return Components(X @ basis, basis.T.reshape(count, channels, n).copy(), mean.reshape(channels, n), lights, matrix)


def predict(fitted: Components, lights: Array) -> Samples:
    """Samples (texel, 3, light) under other lights."""
    M = fitted.matrix(fitted.lights, lights).T.astype(np.float32)
    return np.asarray(np.tensordot(fitted.scores, fitted.components @ M, 1) + fitted.mean @ M)
