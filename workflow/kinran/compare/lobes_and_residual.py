"""Lobes with a residual: a few principal components over lights of the remainder, in display-like values."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.compare import fitted_lobes
from kinran.compare.trial import Trial
from kinran.data.texel_directions import Under
from kinran.fit.components import by_light, principal, remainder
from kinran.fit.few_lights import FEW_LIGHTS
from kinran.fit.fitted_model import Fitted
from kinran.fit.light_splines import plates
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.residual import Residual, expand

Single = NDArray[np.float32]

SMOOTHING = 1e-2
"""Smoothing of thin plates: one of those that `kinran residual` chooses from; the chart does not cross-validate."""


@dataclass(frozen=True)
class ResidualFit:
    """Lobes with a residual.

    Attributes
    ----------
    lobes
        Fit of the lobes.
    residual
        Dependence of the residual on the light.
    maps : (count + 1, texel · 3) float32
        Mean and components of the residual.
    """

    lobes: SlopeFit
    residual: Residual
    maps: Single

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return self.lobes.numbers + 3 * len(self.maps)

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return self.residual.weights.size

    def predict(self, under: Under) -> Single:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        domain, factors = self.residual.domain, self.residual.basis(under.directions).astype(np.float32)
        shown = by_light(under.reaching(self.lobes.predict(under)), domain)
        light = expand(np.float32(self.residual.share) * shown + factors @ self.maps, domain)
        texels_first = np.moveaxis(light.reshape(under.count, -1, 3), 0, -1)
        return under.square_on(np.ascontiguousarray(texels_first, np.float32))


def fit(trial: Trial, wanted: Lobes, components: int, share: float = 1.0) -> Fitted:
    """Fit lobes and, where it has components, their residual.

    Parameters
    ----------
    wanted
        Lobes that are fitted; under few lights it is one of GGX, as in the pipeline.
    components
        Number of components; 0 for lobes alone.
    share
        Share of the lobes in a picture.
    """
    few = trial.samples.under.count < FEW_LIGHTS
    fitted = fitted_lobes.fit(trial.samples, Lobes("ggx", 1) if few else wanted)
    if not components:
        return fitted
    return left_by(fitted, trial.samples, domain_of(trial), components, share)


def domain_of(trial: Trial) -> str:
    """Name of the values in which a trial's residual is: those of its photographs, or the logarithm of radiance."""
    if trial.coder:
        return trial.coder.name
    return f"log:{np.percentile(trial.samples.under.reaching(trial.samples.T), 99.9):.6g}"


def left_by(
    fitted: SlopeFit,
    samples: Samples,
    domain: str,
    components: int,
    share: float = 1.0,
    smoothing: float | None = SMOOTHING,
) -> ResidualFit:
    """Add to a fit the residual that it leaves of its samples, as `kinran residual` does for a material."""
    under = samples.under
    seen, said = (by_light(under.reaching(T), domain) for T in (samples.T, fitted.predict(under)))
    left = remainder(seen, said, domain, share)
    mean = left.mean(0)
    left = left - mean
    basis = principal(left, components)
    maps = np.concatenate([mean[None], basis.T.astype(np.float32) @ left])
    return ResidualFit(fitted, Residual(domain, share, *plates(under.directions, basis, smoothing)), maps)
