"""Interpolation between lights: components [Schneider2004], code vectors [Sekine2004], the samples themselves."""

from kinran.compare.baselines import codebook, components, interpolation
from kinran.compare.method import Method, fit_encoded
from kinran.compare.trial import Trial
from kinran.fit.fitted_model import Fitted

SMOOTHING = 1e-3
"""Smoothing of thin plates over photographs; radiance, which has less noise, goes through its samples. A choice: the
least that `kinran residual` tries."""


def _plate(trial: Trial) -> interpolation.Matrix:
    return interpolation.thin_plate(SMOOTHING if trial.coder else 0.0)


def _components(trial: Trial, count: int) -> Fitted:
    return fit_encoded(trial, lambda samples: components.fit(samples, count, _plate(trial)))


def _codebook(trial: Trial, count: int) -> Fitted:
    return fit_encoded(trial, lambda samples: codebook.fit(samples, count, _plate(trial)))


def _kept(trial: Trial, matrix: interpolation.Matrix) -> Fitted:
    return fit_encoded(trial, lambda samples: interpolation.fit(samples, matrix))


METHODS = (
    Method("PCA 8", "baseline", lambda t: _components(t, 8), 8),
    Method("PCA 9", "baseline", lambda t: _components(t, 9), 9),
    Method("PCA 16", "baseline", lambda t: _components(t, 16), 16, True),
    Method("VQ 64", "baseline", lambda t: _codebook(t, 64), 8),
    Method("VQ 256", "baseline", lambda t: _codebook(t, 256), 8, True),
    Method("Delaunay", "baseline", lambda t: _kept(t, interpolation.linear), 4, True),
    Method("thin plate", "baseline", lambda t: _kept(t, _plate(t)), 4, True),
)
