"""Methods of the chart: each takes a trial's training samples and returns a fit that predicts and has a size."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding
from kinran.compare.trial import Trial
from kinran.data.texel_directions import Under
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


@dataclass(frozen=True)
class Encoded:
    """A fit to the values of photographs, which predicts linear light."""

    fitted: Fitted
    coder: Encoding

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return self.fitted.numbers

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return self.fitted.shared

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        return self.coder.decode(np.clip(self.fitted.predict(under), 0, 1))


def fit_encoded(trial: Trial, fit: Callable[[Samples], Fitted]) -> Fitted:
    """Fit a trial's samples in the encoding of its photographs, in which a baseline does best; radiance as it is."""
    fitted = fit(trial.encoded())
    return Encoded(fitted, trial.coder) if trial.coder else fitted
