"""Generalised cosine lobes [Filip2004], one and two."""

from kinran.baselines import lafortune, lafortune_pair
from kinran.chart.method import Fitted, Method
from kinran.chart.trial import Trial


def _one(trial: Trial) -> Fitted:
    fitted = lafortune.fit(trial.T, trial.lights)
    return Fitted(lambda lights: lafortune.predict(fitted, lights), fitted.numbers)


def _two(trial: Trial) -> Fitted:
    fitted = lafortune_pair.fit(trial.T, trial.W, trial.lights)
    return Fitted(lambda lights: lafortune_pair.predict(fitted, lights), fitted.numbers)


METHODS = (
    Method("Lafortune", "baseline", _one, 8, True),
    Method("Lafortune 2", "baseline", _two, 12, True),
)
