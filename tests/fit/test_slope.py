"""The slope fit: recovery of known lobes, and what happens where fits fail."""

import numpy as np
import pytest
from synthetic_texels import grid, radiance, sampled, texels

from kinran.fit import learned_priors, slope, takeda
from kinran.fit.slope_lobes import Lobes


def relative(fitted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """√(Σ (m - g)² / Σ g²) of each texel."""
    return np.sqrt(((fitted - truth) ** 2).sum((1, 2)) / (truth**2).sum((1, 2)))


def predict(result: slope.SlopeFit, lights: np.ndarray) -> np.ndarray:
    return radiance(result.shapes, result.colours, lights, result.lobes.tail)


def fit(T: np.ndarray, lights: np.ndarray, W: np.ndarray | None = None) -> slope.SlopeFit:
    """One GGX lobe over a bent diffuse term; without weights all samples count alike."""
    return slope.fit(sampled(T, lights, W), Lobes())


@pytest.mark.parametrize("tail", ["ggx", "gaussian"])
def test_recovers_noiseless_lobes(lights: np.ndarray, tail: str) -> None:
    shapes, colours = texels(100)
    T = radiance(shapes, colours, lights, tail)
    result = slope.fit(sampled(T, lights), Lobes(tail))
    error = relative(predict(result, lights), T)
    assert np.median(error) < 1e-3
    assert np.percentile(error, 95) < 0.02
    assert np.median(np.abs(result.shapes[:, :2] - shapes[:, :2])) < 1e-3


def test_held_out_error_under_one_percent_noise(lights: np.ndarray) -> None:
    """Interpolation on lights that the fit did not see; 1 % and 0.003 noise."""
    rng = np.random.default_rng(1)
    shapes, colours = texels(100)
    clean = radiance(shapes, colours, lights)
    noisy = (clean * (1 + 0.01 * rng.normal(size=clean.shape)) + 0.003 * rng.normal(size=clean.shape)).astype("f4")
    held = np.arange(len(lights)) % 8 == 4
    result = fit(noisy[..., ~held], lights[~held])
    assert np.median(relative(predict(result, lights[held]), clean[..., held])) < 0.02


def test_pole_where_the_paper_fails(lights: np.ndarray) -> None:
    """Facets that face the camera: θ_n → 0 leaves φ_n without meaning, and the four steps with it."""
    errors = {}
    for tilt in (0.0, 2.0, 12.0):
        shapes, colours = texels(60)
        azimuth = np.linspace(0, 2 * np.pi, 60)
        shapes[:, 0], shapes[:, 1] = np.tan(np.radians(tilt)) * np.array([np.cos(azimuth), np.sin(azimuth)])
        shapes[:, 2:5] = -np.log(0.12), 0, -np.log(0.12)
        T = radiance(shapes, colours, lights)
        own = relative(predict(fit(T, lights), lights), T)
        steps = takeda.four_steps(sampled(T, lights), np.radians(2.5), np.radians(7.6))
        errors[tilt] = float(np.median(own)), float(np.median(relative(_eq3(steps, lights), T)))
    assert errors[0.0][1] > 0.3
    assert errors[2.0][1] > 0.3
    assert all(own < 0.01 for own, _ in errors.values())


def _eq3(steps: takeda.TakedaFit, lights: np.ndarray) -> np.ndarray:
    from kinran.base import frames
    from kinran_bsdf.models import Takeda2008

    theta, phi = frames.angles(frames.half_vector(lights))
    G = Takeda2008.of_angles(theta, phi, *(steps.shapes[:, k, None] for k in range(4)))
    return steps.colours[:, 0, :, None] * G[:, None] + steps.colours[:, 1, :, None] * lights[:, 2]


def test_saturated_samples_do_not_pull_when_masked(lights: np.ndarray) -> None:
    shapes, colours = texels(80)
    T = radiance(shapes, colours, lights)
    level = 0.5 * T.max((1, 2), keepdims=True)
    clipped = np.minimum(T, level)
    W = (clipped < level).all(1).astype(np.float32)
    naive = np.median(relative(predict(fit(clipped, lights), lights), T))
    masked = np.median(relative(predict(fit(clipped, lights, W), lights), T))
    assert naive > 0.15
    assert masked < 0.02


@pytest.mark.parametrize("value", [0.0, 0.3, 1e-6, 1e6, -0.1])
def test_degenerate_texels_stay_finite(lights: np.ndarray, value: float) -> None:
    T = np.full((3, 3, len(lights)), value, np.float32)
    result = fit(T, lights)
    assert np.isfinite(result.shapes).all()
    assert np.isfinite(result.colours).all()
    assert (result.colours >= 0).all()
    if value <= 0:
        np.testing.assert_array_equal(result.colours, 0)


def test_scale_equivariance(lights: np.ndarray) -> None:
    T = radiance(*texels(20), lights)
    one, thousand = (fit(T * k, lights) for k in (np.float32(1), np.float32(1024)))
    np.testing.assert_allclose(thousand.colours, 1024 * one.colours, rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_one_sample_that_is_no_number_is_left_out(lights: np.ndarray, bad: float) -> None:
    T = radiance(*texels(20), lights)
    broken = T.copy()
    broken[:, 1, 100] = bad
    result = fit(broken, lights)
    assert np.percentile(relative(predict(result, lights), T), 90) < 0.02


def test_all_samples_masked_gives_black() -> None:
    few = grid(20, 4)
    T = radiance(*texels(4), few)
    np.testing.assert_array_equal(fit(T, few, np.zeros((4, len(few)), np.float32)).colours, 0)


def test_few_lights_explode_without_a_prior_and_hold_with_it(lights: np.ndarray) -> None:
    """24 directions: the free fit leaves texels above 1, the region's prior none."""
    shapes, colours = texels(200)
    shapes[:, 2:5] = -np.log(0.1), 0.5, -np.log(0.15)
    rng = np.random.default_rng(2)
    clean = radiance(shapes, colours, lights)
    use = np.sort(rng.choice(len(lights), 24, replace=False))
    T = np.ascontiguousarray(clean[..., use] * (1 + 0.02 * rng.normal(size=(200, 3, 24)))).astype(np.float32)
    samples = sampled(T, lights[use])
    free = slope.fit(samples, Lobes())
    held = slope.fit(samples, Lobes(), learned_priors.region_priors(free, samples, 1))
    free_error, held_error = (relative(predict(r, lights), clean) for r in (free, held))
    assert (free_error > 1).sum() >= 1
    assert (held_error > 1).sum() == 0
    assert np.percentile(held_error, 95) < 0.6 * np.percentile(free_error, 95)


def test_result_does_not_depend_on_the_number_of_threads(lights: np.ndarray) -> None:
    T = radiance(*texels(600), lights)
    one, four = (slope.fit(sampled(T, lights), Lobes(), threads=n) for n in (1, 4))
    np.testing.assert_array_equal(one.shapes, four.shapes)
    np.testing.assert_array_equal(one.colours, four.colours)


def test_widths_stay_above_what_the_lights_resolve(lights: np.ndarray) -> None:
    """A needle between two lights would fit the samples and ruin what lies between."""
    shapes, colours = texels(50)
    shapes[:, 2:5] = -np.log(0.004), 0, -np.log(0.004)
    T = radiance(shapes, colours, lights)
    result = fit(T, lights)
    least = slope.resolution(lights)
    assert 0.02 <= least <= 0.044
    assert np.exp(-result.shapes[:, [2, 4]]).min() >= least * (1 - 1e-9)
