"""Linear bases over the light: Lambert, polynomial texture maps, hemispherical harmonics."""

from kinran.compare.baselines import basis
from kinran.compare.method import Method, fit_encoded
from kinran.compare.trial import Trial
from kinran.fit import lambert
from kinran.fit.fitted_model import Fitted
from kinran.fit.harmonics import harmonics


def _harmonics(trial: Trial, count: int) -> Fitted:
    return fit_encoded(trial, lambda samples: basis.fit(samples, harmonics(count), basis.RIDGE))


METHODS = (
    Method("Lambert", "baseline", lambda t: lambert.fit(t.samples)),
    Method("PTM", "baseline", lambda t: fit_encoded(t, lambda samples: basis.fit(samples, basis.polynomial)), 6, True),
    Method("HSH 9", "baseline", lambda t: _harmonics(t, 9), 9),
    Method("HSH 16", "baseline", lambda t: _harmonics(t, 16), 16, True),
)
