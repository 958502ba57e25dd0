"""Lobes and, on top, a few principal components over lights of what they leave, in display-like values."""

import numpy as np

from kinran.chart import lobes
from kinran.chart.method import Array, Fitted
from kinran.chart.trial import Samples, Trial
from kinran.config import FEW_LIGHTS
from kinran.fit.predict import predict
from kinran_bsdf import residual

SMOOTHING = 1e-2


def fit(trial: Trial, tail: str, count: int, components: int, share: float = 1.0) -> Fitted:
    """Fit lobes and their residual.

    Parameters
    ----------
    tail, count
        Of the lobes.
    components
        Of the residual; 0 for lobes alone.
    share
        Part of the lobes in a picture.
    """
    if len(trial.lights) < FEW_LIGHTS:  # as in the pipeline: two lobes explode
        tail, count = "ggx", 1
    fitted = lobes.fit(trial, tail, count)
    numbers = lobes.numbers(fitted)
    if not components:
        return Fitted(lambda lights: predict(fitted, lights, tail), numbers)
    domain = trial.coder.name if trial.coder else f"log:{np.percentile(trial.T, 99.9):.6g}"

    def shown(T: Samples) -> Samples:
        """(light, texel · 3) of (texel, 3, light)."""
        return np.asarray(residual.compress(T, domain).transpose(2, 0, 1).reshape(T.shape[2], -1), np.float32)

    left = shown(trial.T) - np.float32(share) * shown(predict(fitted, trial.lights, tail))
    mean = left.mean(0)
    left -= mean
    basis = np.linalg.eigh((left @ left.T).astype(float))[1][:, ::-1][:, :components]
    maps = np.concatenate([mean[None], basis.T.astype(np.float32) @ left])
    kept = residual.Residual(domain, share, trial.lights[:, :2], residual.spline(trial.lights, basis, SMOOTHING))

    def relit(lights: Array) -> Samples:
        picture = share * shown(predict(fitted, lights, tail)) + kept.basis(lights).astype(np.float32) @ maps
        light = residual.expand(picture, domain).reshape(len(lights), -1, 3)
        return np.ascontiguousarray(light.transpose(1, 2, 0), np.float32)

    return Fitted(relit, numbers + 3 * len(maps), kept.weights.size)
