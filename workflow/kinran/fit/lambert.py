"""The diffuse term alone, for textures and for regions without a lobe."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Under
from kinran.fit.fitted_model import Channels, named
from kinran.fit.samples import Samples


@dataclass(frozen=True)
class LambertFit:
    """Colours C_d (texel, 3) of T = C_d cos θ_i."""

    colours: NDArray[np.float64]
    numbers: float = 3
    shared: int = 0

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        T = np.empty((len(self.colours), 3, under.count), np.float32)
        for k, at in under.cells():
            T[at] = self.colours[at][:, :, None] * under.lights[k][:, 2]
        return T

    def channels(self) -> Channels:
        """Channels (texel,) of the material's maps."""
        return named((), np.zeros((len(self.colours), 0)), self.colours[:, None])


def fit(samples: Samples) -> LambertFit:
    """Fit T = C_d cos θ_i, C_d ≥ 0, by weighted least squares; samples that are not finite are left out."""
    colours = np.empty((len(samples), 3))
    for k, at in samples.under.cells():
        T, W, cosine = samples.T[at], samples.W[at], samples.under.lights[k][:, 2]
        weight = np.where(np.isfinite(T).all(1), W, 0) * cosine
        top = np.einsum("tcl,tl->tc", np.where(np.isfinite(T), T, 0), weight)
        colours[at] = np.maximum(top / np.maximum(weight @ cosine, 1e-12)[:, None], 0)
    return LambertFit(colours)
