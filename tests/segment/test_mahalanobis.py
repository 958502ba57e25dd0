"""Clustering by Mahalanobis distance, beside k-means and EM, and where clustering dies."""

import numpy as np
import pytest
from clusters_in_colour import agreement, blobs, expectation_maximisation

from kinran.segment import mahalanobis

MAP = (60, 100)


def test_finds_regions_of_very_different_size() -> None:
    features, truth = blobs([3000, 2000, 600, 400])
    labels = mahalanobis.search(features, 4).distances(features).argmin(1)
    assert agreement(labels, truth) > 0.99


def test_same_result_every_time() -> None:
    features, _ = blobs([500, 400, 300, 200])
    first, second = (mahalanobis.search(features, 4) for _ in range(2))
    np.testing.assert_array_equal(first.means, second.means)


@pytest.mark.parametrize("counts", [[6000], [4000, 2000], [3000, 2000, 1000], [3000, 2000, 600, 400]])
def test_chooses_the_number_of_regions_by_the_valleys_between_them(counts: list[int]) -> None:
    assert mahalanobis.choose_count(blobs(counts)[0], 32) == len(counts)


def test_one_long_hill_is_one_region() -> None:
    """K-means cuts a long cluster in halves with centres far apart; there is no valley between them."""
    rng = np.random.default_rng(0)
    features = rng.normal(size=(4000, 4)) * [0.1, 0.1, 3.0, 0.1]
    assert mahalanobis.choose_count(features, 32) == 1


def test_elongated_regions_fool_kmeans_and_not_mahalanobis() -> None:
    rng = np.random.default_rng(1)
    features = np.concatenate([rng.normal(size=(1500, 2)) * [4.0, 0.2] + [0, y] for y in (-1.5, 1.5)])
    truth = np.repeat([0, 1], 1500)
    kmeans = mahalanobis.kmeans(features, 2)
    assert agreement(kmeans, truth) < 0.7
    seeds = np.full(3000, -1, np.intp)
    seeds[[0, 1, 2]], seeds[[1500, 1501, 1502]] = 0, 1
    labels = mahalanobis.grow(features, seeds, 2).distances(features).argmin(1)
    assert agreement(labels, truth) > 0.99


def test_no_worse_than_kmeans_and_expectation_maximisation_on_separate_regions() -> None:
    features, truth = blobs([2000, 1500, 300, 200], seed=3)
    ours = agreement(mahalanobis.search(features, 4).distances(features).argmin(1), truth)
    start = mahalanobis.kmeans(features, 4)
    assert ours >= agreement(start, truth)
    assert ours >= agreement(expectation_maximisation(features, start, 4), truth) - 0.005


def test_mixed_texels_do_not_swell_a_small_region() -> None:
    """The core alone makes the covariance: with all texels, the small region reaches for its neighbour's edge."""
    features, truth = blobs([2400, 200])
    t = np.random.default_rng(2).uniform(0, 0.45, (150, 1))
    mixed = (1 - t) * features[2400 + np.arange(150)] + t * features[:150]
    features = np.concatenate([features, mixed])
    labels = np.concatenate([truth, np.ones(150, int)])
    plain = mahalanobis.estimate(features, labels, 2)
    core = mahalanobis.estimate(features, labels, 2, plain.distances(features))
    spread = [np.trace(np.linalg.inv(regions.inverses[1])) for regions in (plain, core)]
    assert spread[1] < 0.85 * spread[0]


def test_singular_covariance() -> None:
    """Clipped colours lie in a plane: the plain covariance cannot be inverted, the shrunk one can."""
    features, truth = blobs([500, 500])
    features[:, 2] = 0
    assert np.linalg.matrix_rank(np.cov(features[:500].T)) < 4
    assert agreement(mahalanobis.search(features, 2).distances(features).argmin(1), truth) > 0.99


@pytest.mark.parametrize("texels", [0, 1, 2])
def test_a_region_of_next_to_no_texels_has_finite_distances(texels: int) -> None:
    features, truth = blobs([100, max(texels, 1)])
    truth = truth if texels else np.zeros_like(truth)
    distances = mahalanobis.estimate(features, truth, 2).distances(features)
    assert np.isfinite(distances).all()
    if not texels:
        assert (distances[:, 1] > distances[:, 0]).all()


def test_neighbours_settle_what_noise_leaves_open_and_keep_thin_threads() -> None:
    rng = np.random.default_rng(4)
    truth = np.zeros(MAP, int)
    truth[:, 50:] = 1
    truth[30, :50] = 1  # a thread of one texel
    sure = np.where(truth.reshape(-1, 1) == [0, 1], 2.0, 40.0)
    labels = mahalanobis.settle(sure, MAP)
    np.testing.assert_array_equal(labels, truth.reshape(-1))
    truth[30, :50] = 0
    noisy = np.where(truth.reshape(-1, 1) == [0, 1], 4.0, 6.0) + rng.normal(size=(truth.size, 2))
    before = (noisy.argmin(1) == truth.reshape(-1)).mean()
    after = (mahalanobis.settle(noisy, MAP) == truth.reshape(-1)).mean()
    assert before < 0.95
    assert after > 0.99


def test_membership_is_the_share_of_a_mixed_texel() -> None:
    t = np.tile([1.0, 1.0, 0.8, 0.6, 0.0, 0.0], (6, 1))
    distances = 100 * np.stack([(1 - t.reshape(-1)) ** 2, t.reshape(-1) ** 2], 1)
    labels = distances.argmin(1)
    second, share = mahalanobis.membership(distances, labels, (6, 6))
    np.testing.assert_allclose(share.reshape(6, 6)[0], [1, 1, 1, 0.6, 1, 1])
    assert second.reshape(6, 6)[0].tolist() == [0, 0, 0, 1, 0, 1]


def test_confidence_is_a_half_between_two_regions_and_one_in_one() -> None:
    distances = np.array([[1.0, 1.0], [0.0, 9.0], [1.0, 3.0]])
    np.testing.assert_allclose(mahalanobis.confidence(distances, np.zeros(3, np.intp)), [0.5, 1.0, 0.75])
    np.testing.assert_array_equal(mahalanobis.confidence(distances[:, :1], np.zeros(3, np.intp)), 1)
