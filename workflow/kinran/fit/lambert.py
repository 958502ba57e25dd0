"""The diffuse term alone, bent to the facets, for textures and for regions without a lobe."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Under
from kinran.fit.fitted_model import Channels, named
from kinran.fit.lambert_normals import normals
from kinran.fit.samples import Samples

STEEPEST = 2.0
"""Longest slope of a facet, 63°: an outlier among few lights gives steeper ones. A choice."""


@dataclass(frozen=True)
class LambertFit:
    """Colours C_d (texel, 3) and slopes (texel, 2) of T = C_d max(0, l_z + x l_x + y l_y)."""

    colours: NDArray[np.float64]
    slopes: NDArray[np.float64]
    numbers: float = 5
    shared: int = 0

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        T = np.empty((len(self.colours), 3, under.count), np.float32)
        for k, at in under.cells():
            T[at] = self.colours[at][:, :, None] * _factor(self.slopes[at], under.lights[k])[:, None]
        return T

    def channels(self) -> Channels:
        """Channels (texel,) of the material's maps."""
        channels = named((), np.zeros((len(self.colours), 0)), self.colours[:, None])
        channels["diffuse.x"], channels["diffuse.y"] = self.slopes.T
        return channels


def fit(samples: Samples) -> LambertFit:
    """Fit the slopes of `lambert_normals.normals`, then C_d ≥ 0 by weighted least squares.

    Samples that are not finite are left out.
    """
    finite = np.asarray(np.isfinite(samples.T).all(1))
    sound = samples if finite.all() else samples.where(finite)
    facing = normals(sound)
    slopes = facing[:, :2] / np.maximum(facing[:, 2:], 1e-6)
    slopes *= np.minimum(1, STEEPEST / np.maximum(np.hypot(*slopes.T), 1e-9))[:, None]
    colours = np.empty((len(samples), 3))
    for k, at in sound.under.cells():
        factor = _factor(slopes[at], sound.under.lights[k])
        weight = sound.W[at] * factor
        top = np.einsum("tcl,tl->tc", sound.T[at], weight)
        colours[at] = np.maximum(top / np.maximum((weight * factor).sum(1), 1e-12)[:, None], 0)
    return LambertFit(colours, slopes)


def _factor(slopes: NDArray[np.float64], lights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Factor (texel, light) of facets of slopes (texel, 2): `diffuse` of the plugin, which would load the renderer."""
    return np.asarray(np.maximum(lights[:, 2] + slopes @ lights[:, :2].T, 0))
