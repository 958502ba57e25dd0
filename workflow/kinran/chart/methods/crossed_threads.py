"""Orthogonal normals with a Fresnel factor, as far as the paper tells of [Takeda2005, Takeda2006]."""

from kinran.baselines import crossed
from kinran.chart.method import Fitted, Method
from kinran.chart.trial import Trial


def _crossed(trial: Trial) -> Fitted:
    fitted = crossed.fit(trial.T, trial.W, trial.lights)
    return Fitted(lambda lights: crossed.predict(fitted, lights), fitted.numbers)


METHODS = (Method("crossed threads", "paper", _crossed, 12, True),)
