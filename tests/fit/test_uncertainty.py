"""Standard deviations by the Hessian are those of repeated noisy fits."""

import numpy as np
from synthetic_texels import radiance, texels

from kinran.fit import slope, uncertainty

NOISE = 0.01
REPEATS = 60


def test_deviations_are_those_of_repeated_fits(lights: np.ndarray) -> None:
    """Of 60 fits under white noise; the median ratio over texels to within 15 %, for each parameter."""
    rng = np.random.default_rng(0)
    shapes, colours = texels(30)
    clean = radiance(shapes, colours, lights)
    W = np.ones((len(clean), len(lights)), np.float32)
    fits, predicted = [], None
    for _ in range(REPEATS):
        T = (clean + NOISE * rng.normal(size=clean.shape)).astype(np.float32)
        fits.append(slope.fit(T, W, lights))
        predicted = uncertainty.deviations(fits[-1], T, W, lights)
    assert predicted is not None
    for name in ("shapes", "colours"):
        found = np.std([getattr(f, name) for f in fits], axis=0)
        ratio = np.median(found / getattr(predicted, name), axis=0)
        np.testing.assert_allclose(ratio, 1, atol=0.15)


def test_what_nothing_fixes_has_no_bound(lights: np.ndarray) -> None:
    """A texel without a lobe says nothing about its shape."""
    shapes, colours = texels(3)
    colours[:, 0] = 0
    T = radiance(shapes, colours, lights)
    W = np.ones((3, len(lights)), np.float32)
    fitted = slope.SlopeFit(shapes, colours, np.ones(3))
    assert np.isinf(uncertainty.deviations(fitted, T, W, lights).shapes[:, :5]).all()


def test_few_lights_are_less_sure(lights: np.ndarray) -> None:
    shapes, colours = texels(20)
    T = radiance(shapes, colours, lights)
    sd = []
    for step in (1, 4):
        use = slice(None, None, step)
        few = np.ascontiguousarray(T[..., use])
        fitted = slope.SlopeFit(shapes, colours, np.full(20, 0.01 * few.shape[2]))
        W = np.ones((20, few.shape[2]), np.float32)
        sd.append(np.median(uncertainty.deviations(fitted, few, W, lights[use]).shapes, 0))
    assert (sd[1] > 1.5 * sd[0]).all()
