"""Vector quantisation: each texel takes the nearest of a few code vectors, times a brightness [Sekine2004]."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from kinran.compare.baselines import components
from kinran.compare.baselines.interpolation import Matrix
from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

Single = NDArray[np.float32]
Array = NDArray[np.float64]

SCORES = 16
"""Principal components in which k-means tells codes apart: few, so that many texels cost little. No measurement stands
behind the number."""
ROUNDS = 20
"""Rounds of k-means. A choice."""


@dataclass(frozen=True)
class Codebook:
    """Code vectors (k, 3, light), each the mean of texels of unit norm; code and brightness (texel,) of each texel."""

    codes: Single
    code: NDArray[np.intp]
    brightness: Single
    lights: Array
    matrix: Matrix

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps: a brightness, and a code of a byte."""
        return 1.5

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return int(self.codes.size)

    def predict(self, under: Under) -> Single:
        """Values (texel, 3, light) under some lights, of the kind that was fitted."""
        M = self.matrix(self.lights, under.directions).T.astype(np.float32)
        return np.asarray((self.codes @ M)[self.code] * self.brightness[:, None, None])


def fit(samples: Samples, count: int, matrix: Matrix) -> Codebook:
    """Find codes by k-means with a fixed seed, on the scores of texels of unit norm."""
    T, texels = samples.T, len(samples)
    norm = np.linalg.norm(T.reshape(texels, -1), axis=1)
    unit = T / np.maximum(norm, 1e-12)[:, None, None]
    scores = components.fit(replace(samples, T=unit), SCORES, matrix).scores
    count = min(count, texels)
    start = scores[np.random.default_rng(0).choice(texels, count, replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a code that no texel takes is no harm
        code = np.asarray(kmeans2(scores, start, minit="matrix", iter=ROUNDS)[1], np.intp)
    sizes = np.maximum(np.bincount(code, minlength=count), 1)
    codes = np.zeros((count, *T.shape[1:]), np.float32)
    np.add.at(codes, code, unit)
    codes /= sizes[:, None, None].astype(np.float32)
    own = codes[code]
    brightness = (T * own).sum((1, 2)) / np.maximum((own * own).sum((1, 2)), 1e-12)
    return Codebook(codes, code, brightness.astype(np.float32), samples.under.directions, matrix)
