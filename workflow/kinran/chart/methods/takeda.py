"""The paper's Eq. 3: by its four steps, and jointly by non-linear least squares."""

import numpy as np

from kinran.chart.method import Array, Fitted, Method
from kinran.chart.trial import Samples, Trial
from kinran.fit import takeda
from kinran_bsdf import models

NUMBERS = 10


def _four_steps(trial: Trial) -> Fitted:
    return _fitted(takeda.four_steps(trial.T, trial.lights, *_tolerances(trial)))


def _joint(trial: Trial) -> Fitted:
    start = takeda.four_steps(trial.T, trial.lights, *_tolerances(trial))
    return _fitted(takeda.joint(trial.T, trial.W, trial.lights, start))


def _fitted(found: takeda.TakedaFit) -> Fitted:
    C = found.colours[..., None]
    theta, phi, dt, dp = (found.shapes[:, k, None] for k in range(4))

    def predict(lights: Array) -> Samples:
        half = models.half_angles((0.0, 0.0, 1.0), tuple(lights.T))
        lobe = models.takeda_lobe(*half, theta, phi, dt, dp)
        return np.asarray(C[:, 0] * lobe[:, None] + C[:, 1] * lights[:, 2], np.float32)

    return Fitted(predict, NUMBERS)


def _tolerances(trial: Trial) -> tuple[float, float]:
    """Half a step of the grid in θ and φ; 5° and 15° for lights without one. Radians."""
    if trial.grid is None:
        return float(np.radians(5)), float(np.radians(15))
    theta = np.unique(np.round(np.degrees(np.arccos(trial.lights[:, 2])), 3))
    return float(np.radians(0.5 * np.median(np.diff(theta)))), float(1.02 * np.pi / (trial.grid[:, 1].max() + 1))


METHODS = (
    Method("four steps", "paper", _four_steps, 4, True),
    Method("Eq. 3, joint", "paper", _joint, 8, True),
)
