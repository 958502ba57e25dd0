"""Standard deviations by the Hessian are those of repeated noisy fits."""

import numpy as np
from synthetic_texels import radiance, sampled, texels

from kinran.fit import gauss_newton, slope
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

NOISE = 0.01
REPEATS = 60


def deviations(fitted: slope.SlopeFit, samples: Samples) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations of shapes (texel, K) and colours (texel, 2, 3)."""
    sd = np.sqrt(np.diagonal(gauss_newton.covariances(fitted, samples), axis1=1, axis2=2))
    return sd[:, : fitted.lobes.size], sd[:, fitted.lobes.size :].reshape(fitted.colours.shape)


def test_deviations_are_those_of_repeated_fits(lights: np.ndarray) -> None:
    """Of 60 fits under white noise; the median ratio over texels to within 15 %, for each parameter."""
    rng = np.random.default_rng(0)
    shapes, colours = texels(30)
    clean = radiance(shapes, colours, lights)
    fits: list[slope.SlopeFit] = []
    for _ in range(REPEATS):
        samples = sampled((clean + NOISE * rng.normal(size=clean.shape)).astype(np.float32), lights)
        fits.append(slope.fit(samples, Lobes()))
    for name, predicted in zip(("shapes", "colours"), deviations(fits[-1], samples), strict=True):
        found = np.std([getattr(f, name) for f in fits], axis=0)
        ratio = np.median(found / predicted, axis=0)
        np.testing.assert_allclose(ratio, 1, atol=0.15)


def test_what_nothing_fixes_has_no_bound(lights: np.ndarray) -> None:
    """A texel without a lobe says nothing about its shape."""
    shapes, colours = texels(3)
    colours[:, 0] = 0
    fitted = slope.SlopeFit(Lobes(), shapes, colours, np.ones(3), np.zeros(3, bool))
    assert np.isinf(deviations(fitted, sampled(radiance(shapes, colours, lights), lights))[0][:, :5]).all()


def test_few_lights_are_less_sure(lights: np.ndarray) -> None:
    shapes, colours = texels(20)
    samples = sampled(radiance(shapes, colours, lights), lights)
    sd = []
    for step in (1, 4):
        few = samples.only(slice(None, None, step))
        fitted = slope.SlopeFit(Lobes(), shapes, colours, np.full(20, 0.01 * few.under.count), np.zeros(20, bool))
        sd.append(np.median(deviations(fitted, few)[0], 0))
    assert (sd[1] > 1.5 * sd[0]).all()
