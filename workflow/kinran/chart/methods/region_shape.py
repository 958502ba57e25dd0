"""One lobe shape for a region; each texel has its own facet slope and colours."""

from dataclasses import dataclass

import numpy as np

from kinran.chart import lobes
from kinran.chart.method import Array, Fitted, Method
from kinran.chart.trial import Trial
from kinran.fit import learned, slope
from kinran.fit.predict import predict

TAIL = "ggx"
WIDTHS = slice(2, 5)
"""Shapes of a lobe that the region shares."""
TIGHT = 0.03
NUMBERS = 8.5
"""Two slopes, two colours, and a byte that names the region."""


@dataclass(frozen=True)
class _Shared(slope.Prior):
    """A prior that holds the widths and says nothing of where the lobe stands."""

    def stiffness(self) -> Array:
        held = np.zeros(self.centre.size)
        held[WIDTHS] = self.variance / TIGHT**2
        return held


def _region_shape(trial: Trial) -> Fitted:
    known, region = lobes.priors(trial, TAIL, 1, bent=False)
    energy = learned.HOLD * float(np.mean(trial.T.astype(float) ** 2))
    shared: list[slope.Prior] = [_Shared(prior.centre, energy) for prior in known]
    found = slope.fit(trial.T, trial.W, trial.lights, TAIL, 1, shared, region, bent=False)
    shapes = found.shapes.copy()
    shapes[:, WIDTHS] = np.stack([prior.centre[WIDTHS] for prior in known])[region]
    # the colours anew, for widths that are exactly the region's
    fitted = slope.fit(trial.T, trial.W, trial.lights, TAIL, 1, shared, region, bent=False, iterations=0, start=shapes)
    return Fitted(lambda lights: predict(fitted, lights, TAIL), NUMBERS, 3 * len(known))


METHODS = (Method("region's shape", "kinran", _region_shape, 8, True),)
