"""Texels that two regions share, and the priors under which they are fitted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, pictures
from synthetic_texels import sampled

from benchmarks.texels import Split, microfacets, noisy, relative, spread, texels
from kinran.data.labels import read_labels, read_second, write_labels
from kinran.data.texel_directions import Under
from kinran.fit import learned_priors, slope
from kinran.fit.region_priors import Prior
from kinran.fit.slope_lobes import Lobes

COUNT = 120
KINDS = {"one GGX lobe": (Lobes("ggx", 1), 30), "two Gaussian lobes": (Lobes("gaussian", 2), 50)}


@pytest.fixture(scope="module")
def split() -> Split:
    return Split.of_grid(azimuths=36)


@pytest.fixture(scope="module")
def cloth(split: Split) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gold leaf, silk, and texels that are 0.4 of leaf: T, region and second. Microfacets, which no fit assumes."""
    leaf, silk = texels(2 * COUNT), texels(2 * COUNT, seed=1)
    leaf[0][:, 2:5] = -np.log(0.1), 0, -np.log(0.2)
    silk[0][:, 2:5] = -np.log(0.15), 0, -np.log(0.6)
    silk[1][:, 0] *= 0.1
    T = [microfacets(*kind, split.lights) for kind in (leaf, silk)]
    mixed = 0.4 * T[0][COUNT:] + 0.6 * T[1][COUNT:]
    region, second = np.repeat([0, 1, 1], COUNT), np.repeat([0, 1, 0], COUNT)
    return np.concatenate([T[0][:COUNT], T[1][:COUNT], mixed]).astype(np.float32), region, second


@pytest.mark.parametrize("kind", KINDS)
def test_a_shared_texel_takes_the_prior_that_explains_it(split: Split, cloth: tuple, kind: str) -> None:
    """Under the prior of silk alone the leaf in a texel of silk is smeared; under one lobe of each it is not."""
    lobes, count = KINDS[kind]
    clean, region, second = cloth
    use = np.flatnonzero(~split.held)[spread(split.lights[~split.held], count)]
    seen = sampled(noisy(clean), split.lights)
    samples = replace(seen, region=region, second=second).only(use)
    pure = second == region
    priors = learned_priors.learn_priors(samples.of(pure), 2, lobes)
    own, shared = (slope.fit(s, lobes, priors) for s in (samples.unshared(), samples))
    np.testing.assert_array_equal(own.shapes[pure], shared.shapes[pure])
    held = Under.far(split.lights[split.held])
    error = [relative(f.predict(held), clean[..., split.held])[~pure] for f in (own, shared)]
    assert np.median(error[1]) < 0.85 * np.median(error[0])


def test_the_shared_prior_has_a_lobe_of_each_region() -> None:
    """The lobes that reflect the most, the narrower first; of one lobe a texel, that of the other region."""
    one = Prior(np.r_[np.full(5, 1.0), np.full(5, 2.0), 0.2, 0.0], 0.5, main=1)
    other = Prior(np.r_[np.full(5, 3.0), np.full(5, 4.0), 0.0, 0.4], 0.7, main=0)
    shared = one.shared(other)
    np.testing.assert_allclose(shared.centre, np.r_[np.full(5, 3.0), np.full(5, 2.0), 0.1, 0.2])
    assert shared.variance == one.variance
    one, other = (Prior(np.full(7, value), 0.5) for value in (1.0, 3.0))
    np.testing.assert_allclose(one.shared(other).centre, np.r_[np.full(5, 3.0), 2.0, 2.0])


def test_the_main_lobe_reflects_the_most() -> None:
    """A dim wide lobe outweighs a bright needle."""
    shapes = np.zeros((3, 12))
    shapes[:, [2, 4]], shapes[:, [7, 9]] = -np.log(0.1), -np.log(0.5)
    for height, main in ((10.0, 1), (40.0, 0)):
        colours = np.ones((3, 3, 3))
        colours[:, 0] *= height
        fitted = slope.SlopeFit(Lobes("gaussian", 2), shapes, colours, np.ones(3), np.zeros(3, bool))
        samples = sampled(np.zeros((3, 3, 40), np.float32), np.zeros((40, 3)))
        assert learned_priors.region_priors(fitted, samples, 1)[0].main == main


def test_a_texel_is_mixed_where_the_second_has_over_a_fifth(tmp_path: Path) -> None:
    labels, second = np.array([[0, 0, 1]]), np.array([[1, 1, 0]])
    share = np.array([[0.9, 0.7, 0.6]], np.float32)
    write_labels(tmp_path / "labels.exr", labels, share, second, share)
    np.testing.assert_array_equal(
        read_second(tmp_path / "labels.exr", read_labels(tmp_path / "labels.exr")), [[0, 1, 0]]
    )
    np.testing.assert_array_equal(read_labels(tmp_path / "labels.exr"), labels)


def test_the_stage_reads_who_shares_a_texel(tmp_path: Path, split: Split, cloth: tuple) -> None:
    """Only the texels that the label map calls mixed change."""
    clean, region, second = cloth
    use = np.flatnonzero(~split.held)[spread(split.lights[~split.held], 50)]
    shape = (3, COUNT)
    disk = Cloth(tmp_path, pictures(clean[:, :, use], shape), directions(split.lights[use]), region.reshape(shape))
    options = {"lobes": ("gaussian", 2), "prior": True}
    before = disk.fit(**options).channels["lobe1.xx"]
    share = np.where(second != region, 0.6, 1).astype(np.float32).reshape(shape)
    write_labels(tmp_path / "labels.exr", region.reshape(shape), share, second.reshape(shape), share)
    changed = disk.fit(**options).channels["lobe1.xx"] != before
    assert changed[2].mean() > 0.3
    assert not changed[:2].any()
