"""The methods of the chart behind one interface: a trial's training samples in, predictions out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.baselines import basis, codebook, components, interpolation, lafortune
from kinran.chart.trial import Samples, Trial
from kinran.fit import lambert, slope, takeda
from kinran.fit.predict import predict as predict_slope
from kinran_bsdf import models

Array = NDArray[np.float64]
Predict = Callable[[Array], Samples]

PRIOR_SAMPLE = 512
SMOOTHING = 1e-3
"""Of thin plates over photographs; radiance, which has less noise, goes through its samples."""


@dataclass(frozen=True)
class Fitted:
    """A fitted method.

    Attributes
    ----------
    predict
        From lights (light, 3) to T (texel, 3, light).
    numbers, shared
        Numbers that it keeps for each texel, and those that all texels share; two bytes each.
    """

    predict: Predict
    numbers: float
    shared: int = 0

    def bytes_per_texel(self, texels: int) -> float:
        """Bytes of a texel, with its part of what is shared."""
        return 2 * self.numbers + 2 * self.shared / texels


@dataclass(frozen=True)
class Method:
    """A method of the chart.

    Attributes
    ----------
    name, family
        Family is ``baseline``, ``paper`` or ``kinran``.
    fit
        From a trial, of which it uses the training samples alone.
    least_lights
        Below so many lights it is not tried.
    swept
        Whether it is tried with fewer lights and exposures, too.
    """

    name: str
    family: str
    fit: Callable[[Trial], Fitted]
    least_lights: int = 4
    swept: bool = False


def methods() -> list[Method]:
    """All methods, from the simplest to the dearest of each family."""
    return [
        Method("Lambert", "baseline", _lambert),
        Method("PTM", "baseline", lambda t: _linear(t, basis.polynomial), 6, True),
        Method("HSH 9", "baseline", lambda t: _linear(t, basis.harmonics(9), 1e-6), 9),
        Method("HSH 16", "baseline", lambda t: _linear(t, basis.harmonics(16), 1e-6), 16, True),
        Method("PCA 8", "baseline", lambda t: _components(t, 8), 8),
        Method("PCA 16", "baseline", lambda t: _components(t, 16), 16, True),
        Method("VQ 64", "baseline", lambda t: _codebook(t, 64), 8),
        Method("VQ 256", "baseline", lambda t: _codebook(t, 256), 8),
        Method("Delaunay", "baseline", lambda t: _kept(t, interpolation.linear), 4, True),
        Method("thin plate", "baseline", lambda t: _kept(t, _plate(t)), 4),
        Method("Lafortune", "baseline", _lafortune, 8, True),
        Method("four steps", "paper", _four_steps, 4, True),
        Method("Gaussian lobe", "kinran", lambda t: _slope(t, "gaussian", 1, False), 8),
        Method("GGX lobe", "kinran", lambda t: _slope(t, "ggx", 1, False), 8, True),
        Method("GGX lobe, prior", "kinran", lambda t: _slope(t, "ggx", 1, True), 8, True),
        Method("2 Gaussian lobes", "kinran", lambda t: _slope(t, "gaussian", 2, True), 16, True),
    ]


def _lambert(trial: Trial) -> Fitted:
    colour = lambert.fit(trial.T, trial.W, trial.lights).astype(np.float32)
    return Fitted(lambda lights: colour[:, :, None] * lights[:, 2].astype(np.float32), 3)


def _linear(trial: Trial, functions: basis.Basis, ridge: float = 0.0) -> Fitted:
    fitted = basis.fit(trial.encoded(), trial.lights, functions, ridge)
    return Fitted(lambda lights: trial.decoded(basis.predict(fitted, lights)), fitted.numbers)


def _plate(trial: Trial) -> interpolation.Matrix:
    return interpolation.thin_plate(SMOOTHING if trial.coder else 0.0)


def _components(trial: Trial, count: int) -> Fitted:
    fitted = components.fit(trial.encoded(), trial.lights, count, _plate(trial))
    return Fitted(lambda lights: trial.decoded(components.predict(fitted, lights)), fitted.numbers, fitted.shared)


def _codebook(trial: Trial, count: int) -> Fitted:
    fitted = codebook.fit(trial.encoded(), trial.lights, count, _plate(trial))
    return Fitted(lambda lights: trial.decoded(codebook.predict(fitted, lights)), fitted.numbers, fitted.shared)


def _kept(trial: Trial, matrix: interpolation.Matrix) -> Fitted:
    fitted = interpolation.fit(trial.encoded(), trial.lights, matrix)
    return Fitted(lambda lights: trial.decoded(interpolation.predict(fitted, lights)), fitted.numbers)


def _lafortune(trial: Trial) -> Fitted:
    fitted = lafortune.fit(trial.T, trial.lights)
    return Fitted(lambda lights: lafortune.predict(fitted, lights), fitted.numbers)


def _four_steps(trial: Trial) -> Fitted:
    fitted = takeda.four_steps(trial.T, trial.lights, *_tolerances(trial))
    C = fitted.colours[..., None]
    theta, phi, dt, dp = (fitted.shapes[:, k, None] for k in range(4))

    def predict(lights: Array) -> Samples:
        half = models.half_angles((0.0, 0.0, 1.0), tuple(lights.T))
        lobe = models.takeda_lobe(*half, theta, phi, dt, dp)
        return np.asarray(C[:, 0] * lobe[:, None] + C[:, 1] * lights[:, 2], np.float32)

    return Fitted(predict, 10)


def _tolerances(trial: Trial) -> tuple[float, float]:
    """Half a step of the grid in θ and φ; 5° and 15° for lights without one. Radians."""
    if trial.grid is None:
        return float(np.radians(5)), float(np.radians(15))
    theta = np.unique(np.round(np.degrees(np.arccos(trial.lights[:, 2])), 3))
    return float(np.radians(0.5 * np.median(np.diff(theta)))), float(1.02 * np.pi / (trial.grid[:, 1].max() + 1))


def _slope(trial: Trial, tail: str, lobes: int, with_prior: bool) -> Fitted:
    priors = None
    present, region = np.unique(trial.region, return_inverse=True)
    if with_prior:
        some = _sample(region)
        T, W = trial.T[some], trial.W[some]
        priors = slope.learn_priors(T, W, trial.lights, region[some], len(present), tail=tail, lobes=lobes)
    fitted = slope.fit(trial.T, trial.W, trial.lights, tail=tail, lobes=lobes, priors=priors, region=region)
    return Fitted(lambda lights: predict_slope(fitted, lights, tail), fitted.shapes.shape[1] + 3 * (lobes + 1))


def _sample(region: NDArray[np.intp]) -> NDArray[np.intp]:
    """At most 512 texels of each region, evenly through the map."""
    parts = []
    for k in np.unique(region):
        inside = np.flatnonzero(region == k)
        parts.append(inside[np.linspace(0, len(inside) - 1, min(PRIOR_SAMPLE, len(inside))).astype(int)])
    return np.sort(np.concatenate(parts))
