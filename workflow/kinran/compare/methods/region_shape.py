"""One lobe shape for a region; each texel has its own facet slope and colours."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.compare import fitted_lobes
from kinran.compare.method import Method
from kinran.data.texel_directions import Under
from kinran.fit import learned_priors, slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes

LOBE = Lobes("ggx", 1, bent=False)
WIDTHS = slice(2, 5)
"""Indices of the shapes that the lobes of a region share."""
TIGHT = 0.03
"""Standard deviation of the widths in the fit that holds them, before they are set to their region's. A choice."""


@dataclass(frozen=True)
class _Shared(Prior):
    """A prior that holds the widths and says nothing of where the lobe stands."""

    def stiffness(self) -> NDArray[np.float64]:
        held = np.zeros(self.centre.size)
        held[WIDTHS] = self.variance / TIGHT**2
        return held


@dataclass(frozen=True)
class RegionShape:
    """Lobes whose widths are their region's."""

    lobes: SlopeFit
    shared: int
    numbers: float = 8.5
    """Two slopes, two colours, and a byte that names the region."""

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        return self.lobes.predict(under)


def fit(samples: Samples) -> RegionShape:
    """Fit under priors that hold the widths, set them to the region's, then fit the colours anew."""
    samples = fitted_lobes.of_present_regions(samples)
    known = fitted_lobes.priors(samples, LOBE)
    energy = learned_priors.HOLD * float(np.mean(samples.T.astype(float) ** 2))
    shared: list[Prior] = [_Shared(prior.centre, energy) for prior in known]
    samples = samples.unshared()
    found = slope.fit(samples, LOBE, shared)
    shapes = found.shapes.copy()
    shapes[:, WIDTHS] = np.stack([prior.centre[WIDTHS] for prior in known])[samples.region]
    return RegionShape(slope.fit(samples, LOBE, shared, start=shapes, iterations=0), 3 * len(known))


METHODS = (Method("region's shape", "kinran", lambda t: fit(t.samples), 8, True),)
