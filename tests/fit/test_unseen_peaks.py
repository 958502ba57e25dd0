"""No sparks: at 2,000 directions of the dome a texel stays within what its samples bear, whatever the dome's gaps."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_texels import sampled, texels

from benchmarks.texels import microfacets, noisy, relative
from kinran.base import frames
from kinran.data.texel_directions import Under
from kinran.fit import slope, under_priors, unseen_peaks
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

COUNT = 300
PAIR = Lobes("gaussian", 2)


def rings(lights: int, *thetas: float) -> np.ndarray:
    """Lights of a dome in rings at these angles in degrees, as many in each."""
    each = lights // len(thetas)
    t, k = np.meshgrid(np.radians(thetas), np.arange(each), indexing="ij")
    return frames.direction(t.ravel(), (k * 2 * np.pi / each).ravel())


def dome(count: int = 2000) -> np.ndarray:
    """Directions spread evenly over the dome, to 85° [Vogel1979]."""
    z = 1 - (np.arange(count) + 0.5) / count * (1 - np.cos(np.radians(85)))
    return frames.direction(np.arccos(z), np.arange(count) * np.pi * (3 - np.sqrt(5)))


def gloss(lights: np.ndarray, width: float = 0.1) -> Samples:
    """Glossy microfacets, tilted by up to 25°, with noise."""
    shapes, colours = texels(COUNT)
    shapes[:, 2:5] = -np.log(width), 0, -np.log(width)
    return sampled(noisy(microfacets(shapes, colours, lights)), lights)


def spark(fitted: slope.SlopeFit, samples: Samples) -> np.ndarray:
    """Most that each texel reflects to any side, over its brightest sample."""
    seen = fitted.predict(Under.far(dome(), len(samples))).max((1, 2))
    return np.asarray(seen / samples.T.max((1, 2)))


@pytest.mark.parametrize("thetas", [(20, 60), (45,), (15, 35, 75)], ids=str)
@pytest.mark.parametrize("lights", [18, 30, 60])
@pytest.mark.parametrize("lobes", [Lobes(), PAIR], ids=["one", "two"])
def test_no_sparks_between_rings(thetas: tuple[float, ...], lights: int, lobes: Lobes) -> None:
    """A peak is at most `RISE` times the brightest sample; the diffuse term and a second lobe add a little."""
    samples = gloss(rings(lights, *thetas))
    assert spark(under_priors.fit(samples, lobes), samples).max() < 1.25 * unseen_peaks.RISE


def test_what_sparks_without() -> None:
    """The failure: under two rings of 15 lights, a texel in thirty has ten times its brightest sample somewhere."""
    samples = gloss(rings(30, 20, 60))
    without = slope.fit(samples, PAIR)
    held = unseen_peaks.refit(without, samples)
    assert np.mean(spark(without, samples) > 10) > 0.03
    assert 0.03 < held.widened.mean() < 0.5
    shapes, colours = texels(COUNT)
    shapes[:, 2:5] = -np.log(0.1), 0, -np.log(0.1)
    truth = microfacets(shapes, colours, dome(200))
    errors = [fit.predict(Under.far(dome(200), COUNT)) - truth for fit in (without, held)]
    assert np.square(errors[1]).sum() < 0.2 * np.square(errors[0]).sum()


def test_texels_whose_peaks_are_seen_stay_as_they_are() -> None:
    """Of lobes that are wider than the gaps of their lights none is touched."""
    samples = gloss(rings(60, 10, 25, 40, 55, 70), 0.35)
    fitted = slope.fit(samples, Lobes())
    held = unseen_peaks.refit(fitted, samples)
    assert not held.widened.any()
    np.testing.assert_array_equal(held.shapes, fitted.shapes)
    np.testing.assert_array_equal(held.colours, fitted.colours)


def test_a_saturated_light_sees_a_peak() -> None:
    """Its sample is no more than a bound, so a peak there may be over all samples; without it, nobody saw the peak."""
    samples = gloss(rings(60, 10, 25, 40, 55, 70), 0.35)
    fitted = slope.fit(samples, Lobes())
    peak = samples.T.mean(1).argmax(1)
    lost = np.zeros(samples.W.shape, bool)
    for k in range(COUNT):  # all lights that see a part of the peak
        near = np.linalg.norm(samples.under.slopes[0] - samples.under.slopes[0][peak[k]], axis=1) < 0.5
        lost[k] = near
    unseen = replace(samples, W=np.where(lost, 0, samples.W).astype(np.float32))
    bounded = replace(unseen, bounds=lost.astype(np.float32))
    assert not unseen_peaks.refit(fitted, bounded).widened.any()
    assert unseen_peaks.refit(fitted, unseen).widened.any()


def test_a_texel_without_samples_stays_dark() -> None:
    samples = gloss(rings(30, 20, 60))
    nothing = replace(samples, W=np.zeros_like(samples.W))
    held = unseen_peaks.refit(slope.fit(nothing, PAIR), nothing)
    assert np.isfinite(held.shapes).all()
    assert (held.colours == 0).all()


def test_a_search_is_repeated_from_the_brightest_sample() -> None:
    """The failure: where it is not, needles between two rings meet their brightest samples, and nothing else."""
    samples = gloss(rings(60, 20, 60), 0.2)
    shapes, colours = texels(COUNT)
    shapes[:, 2:5] = -np.log(0.2), 0, -np.log(0.2)
    truth = microfacets(shapes, colours, dome(300))
    priors = under_priors.learn(samples, 1, PAIR)
    fitted = under_priors.fit(samples.weighed(priors.lights), PAIR, priors)
    errors = relative(fitted.predict(Under.far(dome(300), COUNT)), truth)
    assert np.percentile(errors, 95) < 0.4
