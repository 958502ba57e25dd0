"""Elliptical lobes in slope space, each texel alone and under its region's prior."""

from kinran.chart import lobes
from kinran.chart.method import Fitted, Method
from kinran.chart.trial import Trial
from kinran.fit.predict import predict


def _slope(trial: Trial, tail: str, count: int, with_prior: bool) -> Fitted:
    fitted = lobes.fit(trial, tail, count, with_prior)
    return Fitted(lambda lights: predict(fitted, lights, tail), lobes.numbers(fitted))


METHODS = (
    Method("Gaussian lobe", "kinran", lambda t: _slope(t, "gaussian", 1, False), 8),
    Method("GGX lobe", "kinran", lambda t: _slope(t, "ggx", 1, False), 8, True),
    Method("GGX lobe, prior", "kinran", lambda t: _slope(t, "ggx", 1, True), 8, True),
    Method("2 Gaussian lobes", "kinran", lambda t: _slope(t, "gaussian", 2, False), 16, True),
    Method("2 Gaussian lobes, prior", "kinran", lambda t: _slope(t, "gaussian", 2, True), 16, True),
    Method("2 GGX lobes, prior", "kinran", lambda t: _slope(t, "ggx", 2, True), 16),
)
