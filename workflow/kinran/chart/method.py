"""What a method of the chart is: a trial's training samples in, predictions out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.chart.trial import Samples, Trial

Array = NDArray[np.float64]
Predict = Callable[[Array], Samples]

FAMILIES = ("baseline", "paper", "kinran")


@dataclass(frozen=True)
class Fitted:
    """A fitted method.

    Attributes
    ----------
    predict
        From lights (light, 3) to T (texel, 3, light).
    numbers, shared
        Numbers that it keeps for each texel, and those that all texels share; two bytes each.
    """

    predict: Predict
    numbers: float
    shared: int = 0

    def bytes_per_texel(self, texels: int) -> float:
        """Bytes of a texel, with its part of what is shared."""
        return 2 * self.numbers + 2 * self.shared / texels


@dataclass(frozen=True)
class Method:
    """A method of the chart.

    Attributes
    ----------
    name, family
        Family is ``baseline``, ``paper`` or ``kinran``.
    fit
        From a trial, of which it uses the training samples alone.
    least_lights
        Below so many lights it is not tried.
    swept
        Whether it is tried with fewer lights and exposures, too.
    """

    name: str
    family: str
    fit: Callable[[Trial], Fitted]
    least_lights: int = 4
    swept: bool = False
