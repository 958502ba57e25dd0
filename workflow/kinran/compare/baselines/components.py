"""Principal components over the lights, interpolated between them [Schneider2004]."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.compare.baselines.interpolation import Matrix
from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

Single = NDArray[np.float32]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Components:
    """Scores of each texel over shared components.

    Attributes
    ----------
    scores : (texel, k) float32
    components : (k, 3, light) float32
        Orthonormal principal components.
    mean : (3, light) float32
    lights : (light, 3)
        Directions from the field's centre.
    matrix
        Interpolation of the components to other lights.
    """

    scores: Single
    components: Single
    mean: Single
    lights: Array
    matrix: Matrix

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return float(self.scores.shape[1])

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return int(self.components.size + self.mean.size)

    def predict(self, under: Under) -> Single:
        """Values (texel, 3, light) under some lights, of the kind that was fitted."""
        M = self.matrix(self.lights, under.directions).T.astype(np.float32)
        return np.asarray(np.tensordot(self.scores, self.components @ M, 1) + self.mean @ M)


def fit(samples: Samples, count: int, matrix: Matrix) -> Components:
    """Find the first `count` principal components of the texels' vectors (3 · light).

    They come from the smaller of the two Gram matrices, so that neither many texels nor many lights cost much.
    """
    texels, channels, n = samples.T.shape
    X = samples.T.reshape(texels, channels * n)
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
    found = basis.T.reshape(count, channels, n).copy()
    return Components(X @ basis, found, mean.reshape(channels, n), samples.under.directions, matrix)
