"""Two Gaussian lobes and a residual of 4, 9 or 16 components."""

from kinran.compare import lobes_and_residual
from kinran.compare.method import Method
from kinran.fit.slope_lobes import Lobes

LOBES = Lobes("gaussian", 2)

METHODS = (
    Method("lobes + residual 4", "kinran", lambda t: lobes_and_residual.fit(t, LOBES, 4), 20),
    Method("lobes + residual 9", "kinran", lambda t: lobes_and_residual.fit(t, LOBES, 9), 20, True),
    Method("lobes + residual 16", "kinran", lambda t: lobes_and_residual.fit(t, LOBES, 16), 20),
)
