"""Linear bases over the light: Lambert, polynomial texture maps, hemispherical harmonics."""

import numpy as np

from kinran.baselines import basis
from kinran.chart.method import Fitted, Method
from kinran.chart.trial import Trial
from kinran.fit import lambert


def _lambert(trial: Trial) -> Fitted:
    colour = lambert.fit(trial.T, trial.W, trial.lights).astype(np.float32)
    return Fitted(lambda lights: colour[:, :, None] * lights[:, 2].astype(np.float32), 3)


def _basis(trial: Trial, functions: basis.Basis, ridge: float = 0.0) -> Fitted:
    fitted = basis.fit(trial.encoded(), trial.lights, functions, ridge)
    return Fitted(lambda lights: trial.decoded(basis.predict(fitted, lights)), fitted.numbers)


METHODS = (
    Method("Lambert", "baseline", _lambert),
    Method("PTM", "baseline", lambda t: _basis(t, basis.polynomial), 6, True),
    Method("HSH 9", "baseline", lambda t: _basis(t, basis.harmonics(9), 1e-6), 9),
    Method("HSH 16", "baseline", lambda t: _basis(t, basis.harmonics(16), 1e-6), 16, True),
)
