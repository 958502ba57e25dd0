"""Saturated samples as lower bounds: never taken at face value."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from cloth_on_disk import Cloth, directions
from synthetic_texels import grid, radiance, sampled, texels

from benchmarks.texels import Split, microfacets, noisy
from kinran.data.fabric import Fabric
from kinran.data.radiance import SATURATED, Radiance
from kinran.data.radiance_stack import write_shards
from kinran.data.texel_directions import Under
from kinran.fit import bounded, learned_priors, slope
from kinran.fit.samples import Samples, read_samples
from kinran.fit.slope_lobes import Lobes

COUNT = 100
PAIR = Lobes("gaussian", 2)


def clipped(share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples cut so that about this share of them is saturated, where that is, lights."""
    lights = grid(10, 24)
    T = radiance(*texels(COUNT), lights, "gaussian")
    level = np.quantile(T.max(1), 1 - share, axis=1)[:, None, None]
    return np.minimum(T, level), (level <= T).any(1), lights


def cut(T: np.ndarray, saturated: np.ndarray, lights: np.ndarray, weight: float = 0) -> Samples:
    """Samples of which some are bounds, and have this weight besides."""
    samples = sampled(T, lights, np.where(saturated, weight, 1).astype(np.float32))
    return replace(samples, bounds=saturated.astype(np.float32))


def peak_error(fitted: slope.SlopeFit, truth: np.ndarray) -> float:
    colours = fitted.colours[:, 0, 0]
    return float(np.median(np.abs(colours / truth - 1)))


def test_bounds_find_the_peak_that_was_cut_off() -> None:
    """5 % of the samples are cut: at a weight of 0.2 they pull the peak down by 7 %, as bounds by 2 %."""
    T, saturated, lights = clipped(0.05)
    truth = texels(COUNT)[1][:, 0, 0]
    samples = cut(T, saturated, lights, 0.2)
    first = slope.fit(samples, Lobes("gaussian"))
    again = bounded.refit(first, samples)
    assert peak_error(first, truth) > 0.05
    assert peak_error(again, truth) < 0.5 * peak_error(first, truth)


def rolled(level: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, Split]:
    """Threads rolled within a texel, microfacets on each of 24 facets, cut at a share of the highest peak.

    Returns
    -------
    Samples and whether they are saturated, under the lights of the fit; the truth under the others; the split.
    """
    split, rng = Split.of_grid(), np.random.default_rng(0)
    shapes, colours = texels(COUNT)
    shapes[:, 2:5] = np.array([-np.log(0.09), 0.3, -np.log(0.16)]) + rng.normal(0, 0.1, (COUNT, 3))
    clean, middle = np.zeros((COUNT, 3, len(split.lights)), np.float32), shapes[:, :2].copy()
    for _ in range(24):
        shapes[:, :2] = middle + rng.normal(0, 0.08, (COUNT, 2)) * [1, 0.3]
        clean += microfacets(shapes, colours, split.lights) / 24
    seen = np.minimum(noisy(clean), np.float32(level) * clean.max())[..., ~split.held]
    return np.ascontiguousarray(seen), (seen >= level * clean.max()).any(1), clean[..., split.held], split


def error(fitted: slope.SlopeFit, split: Split, truth: np.ndarray) -> float:
    difference = fitted.predict(Under.far(split.lights[split.held])) - truth
    return float(np.sqrt(np.square(difference).sum() / np.square(truth).sum()))


def test_texels_that_lost_their_peaks_are_of_one_lobe_of_their_region() -> None:
    """20 % are saturated: two lobes miss most of the peak, and one lobe alone makes too much of it."""
    T, saturated, truth, split = rolled(0.12)
    samples = cut(T, saturated, split.lights[~split.held])
    assert 0.15 < saturated.mean() < 0.25
    priors = learned_priors.learn_priors(samples, 1, PAIR)
    two, one = slope.fit(samples, PAIR, priors), slope.fit(samples, Lobes())
    again = bounded.refit(two, samples, priors)
    assert error(two, split, truth) > 0.28
    assert error(one, split, truth) > 0.4
    assert error(again, split, truth) < 0.2


def test_a_prior_is_the_stiffer_the_more_of_the_energy_is_lost() -> None:
    """What lobes leave is in proportion to what is seen; flanks alone would seem to be fitted well."""
    variances = {}
    for level in (1.1, 0.12):
        T, saturated, _, split = rolled(level)
        (prior,) = learned_priors.learn_priors(cut(T, saturated, split.lights[~split.held]), 1, Lobes())
        variances[level] = prior.variance
        assert prior.lone is None
    assert 0.3 < variances[0.12] / variances[1.1] < 3


def test_a_lobe_of_ggx_as_two_gaussians() -> None:
    under = Under.far(grid(5, 24))
    one = slope.SlopeFit(Lobes(), *texels(COUNT), np.zeros(COUNT), np.zeros(COUNT, bool))
    whole = one.predict(under)
    left = bounded.as_pair(one, PAIR).predict(under) - whole
    assert np.abs(left).max() < 0.04 * whole.max()


def test_bounds_of_a_stack(tmp_path: Path) -> None:
    """Only where a sample is saturated and no defect; none at all where nothing is."""
    seen, flags = np.full((4, 2, 2, 3), 0.5, np.float32), np.zeros((4, 2, 2, 3), np.uint8)
    cloth = Cloth(tmp_path, seen, directions(grid(40, 3)[:4]))
    assert read_samples(Fabric(tmp_path), (0, 2, 0, 2)).bounds is None
    flags[1, 0, 1, 2] = SATURATED
    write_shards(cloth.stack, 0, Radiance(seen, flags))
    tile = read_samples(Fabric(tmp_path), (0, 2, 0, 2))
    assert tile.bounds is not None
    expected = np.zeros((4, 4), np.float32)
    expected[1, 1] = 1
    np.testing.assert_array_equal(tile.bounds, expected)
    np.testing.assert_array_equal(tile.W, 1 - expected)
