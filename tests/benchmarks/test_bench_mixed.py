"""The benchmark of texels that two threads share."""

from dataclasses import replace

import numpy as np
from trials import SHAPE, shiny_trial, with_samples

from benchmarks import mixed
from kinran.data.texel_directions import Under


def test_pure_texels_keep_their_error_and_mixed_ones_gain() -> None:
    """Under 20 lights, with half a texel of the other region in a third of them."""
    tried = shiny_trial()
    is_mixed = np.arange(tried.texels) % 3 == 0

    def halved(values: np.ndarray) -> np.ndarray:
        blend = 0.3 * values + 0.7 * values[::-1]
        return np.where(is_mixed[:, None, None], blend, values).astype(np.float32)

    tried = replace(with_samples(tried, T=halved(tried.samples.T)), truth=halved(tried.truth))
    few = tried.under(np.arange(0, 40, 2))
    few = with_samples(few, second=np.where(is_mixed, few.samples.region[::-1], few.samples.region))
    own, shared = mixed.measure(few, np.where(is_mixed, 0.5, 1.0))
    assert shared["purity 0-0.7"] < own["purity 0-0.7"]
    assert shared["purity 0.9-1"] == own["purity 0.9-1"]


def test_coarse_texels_are_means() -> None:
    tried = shiny_trial()
    labels = np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), np.intp)
    wide = mixed.coarse(tried, 2, labels, labels + 1)
    assert wide.texels == labels.size == len(wide.samples.region) == len(wide.samples.second)
    T = tried.samples.T
    first = T.reshape(*SHAPE, *T.shape[1:])[:2, :2].mean((0, 1))
    np.testing.assert_allclose(wide.samples.T[0], first, rtol=1e-6)
    assert wide.valid.all()


def test_coarse_texels_stand_where_their_blocks_do() -> None:
    """Under lamps that reach some texels less: what is measured is the mean, and so is the falloff."""
    tried = shiny_trial()
    cell = np.arange(tried.texels) % SHAPE[1] // 6
    falloff = np.linspace(0.5, 1, tried.texels, dtype=np.float32)[:, None]

    def near(under: Under) -> Under:
        twice = {name: getattr(under, name).repeat(2, 0) for name in ("lights", "slopes")}
        return replace(under, cell=cell, falloff=falloff.repeat(under.count, 1), **twice)

    tried = replace(with_samples(tried, under=near(tried.samples.under)), held=near(tried.held))
    labels = np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), np.intp)
    wide = mixed.coarse(tried, 2, labels, labels)
    np.testing.assert_array_equal(wide.samples.under.cell.reshape(labels.shape)[0], np.repeat([0, 1], 3))
    measured = tried.samples.under.reaching(tried.samples.T)
    block = measured.reshape(*SHAPE, *measured.shape[1:])[:2, :2].mean((0, 1))
    np.testing.assert_allclose(wide.samples.under.reaching(wide.samples.T)[0], block, rtol=1e-6)
    np.testing.assert_allclose(wide.held.falloff[0], falloff.reshape(SHAPE)[:2, :2].mean(), rtol=1e-6)
