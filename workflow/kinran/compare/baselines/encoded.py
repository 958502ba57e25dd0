"""Fits to the values of photographs, which predict linear light: so linear baselines do best, and are used."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding
from kinran.data.texel_directions import Under
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples


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


def fit(samples: Samples, coder: Encoding | None, method: Callable[[Samples], Fitted]) -> Fitted:
    """Fit samples of linear light in the encoding of their photographs; radiance, which has none, as it is."""
    if coder is None:
        return method(samples)
    return Encoded(method(replace(samples, T=coder.encode(samples.T))), coder)
