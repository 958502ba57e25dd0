"""Elliptical lobes in slope space, each texel alone and under its region's prior."""

from kinran.compare import fitted_lobes
from kinran.compare.method import Method
from kinran.fit import slope
from kinran.fit.slope_lobes import Lobes

GAUSSIAN, GGX = Lobes("gaussian", 1), Lobes("ggx", 1)
TWO_GAUSSIANS, TWO_GGX = Lobes("gaussian", 2), Lobes("ggx", 2)

METHODS = (
    Method("Gaussian lobe", "kinran", lambda t: slope.fit(t.samples, GAUSSIAN), 8),
    Method("GGX lobe", "kinran", lambda t: slope.fit(t.samples, GGX), 8, True),
    Method("GGX lobe, prior", "kinran", lambda t: fitted_lobes.fit(t.samples, GGX), 8, True),
    Method("2 Gaussian lobes", "kinran", lambda t: slope.fit(t.samples, TWO_GAUSSIANS), 16, True),
    Method("2 Gaussian lobes, prior", "kinran", lambda t: fitted_lobes.fit(t.samples, TWO_GAUSSIANS), 16, True),
    Method("2 GGX lobes, prior", "kinran", lambda t: fitted_lobes.fit(t.samples, TWO_GGX), 16),
)
