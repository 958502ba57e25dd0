"""Vector quantisation: each texel takes the nearest of a few code vectors, times a brightness [Sekine2004]."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from kinran.baselines import components
from kinran.baselines.interpolation import Matrix

Samples = NDArray[np.float32]
Array = NDArray[np.float64]

SCORES = 16
"""Principal components in which k-means tells codes apart: few, so that many texels cost little. No measurement stands
behind the number."""


@dataclass(frozen=True)
class Codebook:
    """Codes (k, 3, light) of unit norm's shape, and for each texel its code (texel,) and brightness (texel,)."""

    codes: Samples
    code: NDArray[np.intp]
    brightness: Samples
    lights: Array
    matrix: Matrix

    @property
    def numbers(self) -> float:
        """Numbers of a texel: a brightness, and a code of a byte."""
        return 1.5

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return int(self.codes.size)


def fit(T: Samples, lights: Array, count: int, matrix: Matrix) -> Codebook:
    """Codes by k-means, seeded alike every time, on the scores of unit-norm texels."""
    texels = len(T)
    norm = np.linalg.norm(T.reshape(texels, -1), axis=1)
    unit = T / np.maximum(norm, 1e-12)[:, None, None]
    scores = components.fit(unit, lights, SCORES, matrix).scores
    count = min(count, texels)
    start = scores[np.random.default_rng(0).choice(texels, count, replace=False)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a code that no texel takes is no harm
        code = np.asarray(kmeans2(scores, start, minit="matrix", iter=20)[1], np.intp)
    sizes = np.maximum(np.bincount(code, minlength=count), 1)
    codes = np.zeros((count, *T.shape[1:]), np.float32)
    np.add.at(codes, code, unit)
    codes /= sizes[:, None, None].astype(np.float32)
    own = codes[code]
    brightness = (T * own).sum((1, 2)) / np.maximum((own * own).sum((1, 2)), 1e-12)
    return Codebook(codes, code, brightness.astype(np.float32), lights, matrix)


def predict(fitted: Codebook, lights: Array) -> Samples:
    """Samples (texel, 3, light) under other lights."""
    M = fitted.matrix(fitted.lights, lights).T.astype(np.float32)
    return np.asarray((fitted.codes @ M)[fitted.code] * fitted.brightness[:, None, None])
