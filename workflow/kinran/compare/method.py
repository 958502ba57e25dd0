"""Methods of the chart: each takes a trial's training samples and returns a fit that predicts and has a size."""

from collections.abc import Callable
from dataclasses import dataclass

from kinran.compare.baselines import encoded
from kinran.compare.trial import Trial
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples

FAMILIES = ("baseline", "paper", "kinran")
NUMBER = 2
"""Bytes of a number, at half precision."""


@dataclass(frozen=True)
class Method:
    """A method of the chart.

    Attributes
    ----------
    name, family
        Family is ``baseline``, ``paper`` or ``kinran``.
    fit
        Function from a trial, of which it uses the training samples alone, to a fit.
    least_lights
        Fewest lights that the method is tried with.
    swept
        Whether the method is tried with fewer lights and exposures, too.
    """

    name: str
    family: str
    fit: Callable[[Trial], Fitted]
    least_lights: int = 4
    swept: bool = False


def bytes_per_texel(fitted: Fitted, texels: int) -> float:
    """Bytes per texel, with an equal part of the numbers that all texels share."""
    return NUMBER * (fitted.numbers + fitted.shared / texels)


def fit_encoded(trial: Trial, fit: Callable[[Samples], Fitted]) -> Fitted:
    """Fit a trial's samples in the encoding of its photographs, in which a baseline does best; radiance as it is."""
    return encoded.fit(trial.samples, trial.coder, fit)
