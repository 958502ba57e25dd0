"""Two Gaussian lobes and a residual of 4, 9 or 16 components."""

from kinran.chart import residual
from kinran.chart.method import Fitted, Method
from kinran.chart.trial import Trial


def _lobes(trial: Trial, components: int) -> Fitted:
    return residual.fit(trial, "gaussian", 2, components)


METHODS = (
    Method("lobes + residual 4", "kinran", lambda t: _lobes(t, 4), 20),
    Method("lobes + residual 9", "kinran", lambda t: _lobes(t, 9), 20, True),
    Method("lobes + residual 16", "kinran", lambda t: _lobes(t, 16), 20),
)
