"""Segmentation by Mahalanobis distance, and where clustering dies."""

import numpy as np
import pytest

from kinran.files import InputError
from kinran.segment import cluster, colour_name, standardised


def blobs(counts: list[int], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Elongated clusters, as colours of one thread under its shading are."""
    rng = np.random.default_rng(seed)
    centres = np.array([[0, 0, 0, 3], [3, 0, 0, 0], [0, 3, 0, 0], [0, 0, -3, 0]], float)
    features, truth = [], []
    for k, count in enumerate(counts):
        x = rng.normal(size=(count, 4)) * [0.2, 0.2, 0.6, 0.3]
        features.append(x + centres[k])
        truth += [k] * count
    return np.concatenate(features), np.array(truth)


def agreement(labels: np.ndarray, truth: np.ndarray) -> float:
    """Share of texels that are right, with each found region named by its majority."""
    return sum(np.bincount(truth[labels == k]).max() for k in np.unique(labels)) / len(truth)


def test_finds_regions_of_very_different_size() -> None:
    features, truth = blobs([3000, 2000, 300, 200])
    labels, distance = cluster(features, 4, "test", strict=True)
    assert agreement(labels, truth) > 0.99
    assert distance.shape == labels.shape
    assert (distance >= 0).all()


def test_same_result_every_time() -> None:
    features, _ = blobs([500, 400, 300, 200])
    first, second = (cluster(features, 4, "test", strict=True)[0] for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_region_with_too_few_texels_stops_when_the_number_was_asked_for() -> None:
    features = np.concatenate([blobs([2000])[0], np.full((3, 4), 40.0)])
    with pytest.raises(InputError, match="ask for fewer regions"):
        cluster(features, 2, "labels.exr", strict=True)
    labels, _ = cluster(features, 2, "labels.exr", strict=False)
    np.testing.assert_array_equal(labels, 0)


def test_too_few_texels_at_all() -> None:
    with pytest.raises(InputError, match="too few to segment"):
        cluster(np.zeros((10, 4)), 1, "labels.exr", strict=False)


def test_one_region_and_constant_features() -> None:
    labels, distance = cluster(np.zeros((100, 4)), 4, "test", strict=False)
    assert np.isfinite(distance).all()
    assert len(np.unique(labels)) == 1


def test_singular_covariance() -> None:
    """Clipped colours lie in a plane: the plain covariance cannot be inverted, the shrunk one can."""
    features, truth = blobs([500, 500])
    features[:, 2] = 0
    assert np.linalg.matrix_rank(np.cov(features[:500].T)) < 4
    assert agreement(cluster(features, 2, "test", strict=True)[0], truth) > 0.99


def test_black_and_bright_texels_have_finite_features() -> None:
    median = np.zeros((8, 8, 3), np.float32)
    median[4:] = 1e4
    features = standardised(median, median[..., 0], median[..., 0])
    assert np.isfinite(features).all()


@pytest.mark.parametrize(
    ("rgb", "name"),
    [
        ((1.0, 0.75, 0.35), "gold"),
        ((0.5, 0.03, 0.025), "red"),
        ((0.03, 0.06, 0.35), "blue"),
        ((0.05, 0.25, 0.06), "green"),
        ((0.7, 0.68, 0.6), "white"),
        ((0.1, 0.1, 0.1), "grey"),
        ((0.01, 0.0, 0.0), "dark"),
        ((0.5, 0.0, 0.05), "red"),
    ],
)
def test_names_of_colours(rgb: tuple[float, float, float], name: str) -> None:
    assert colour_name(np.array(rgb)) == name
