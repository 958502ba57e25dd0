"""Conventions: X weft, Y warp, N view; θ from N, φ from X towards Y; V = N."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from kinran.base import frames

POLAR = st.floats(0.0, 1.5)
AZIMUTH = st.floats(0.0, 6.28)


@given(POLAR, AZIMUTH)
def test_angles_invert_directions(theta: float, phi: float) -> None:
    t, p = frames.angles(frames.direction(theta, phi))
    assert t == pytest.approx(theta, abs=1e-12)
    if theta > 1e-6:
        assert abs(frames.wrap(p - phi)) < 1e-9


@given(POLAR, AZIMUTH)
def test_half_vector_has_half_the_angle_and_the_azimuth_of_the_light(theta: float, phi: float) -> None:
    t, p = frames.angles(frames.half_vector(frames.direction(theta, phi)))
    assert t == pytest.approx(theta / 2, abs=1e-9)
    if theta > 1e-6:
        assert abs(frames.wrap(p - phi)) < 1e-9


@given(POLAR, AZIMUTH)
def test_slopes_are_those_of_the_half_vector(theta: float, phi: float) -> None:
    light = frames.direction(theta, phi)
    h = frames.half_vector(light)
    np.testing.assert_allclose(frames.slopes(light), h[:2] / h[2], atol=1e-12)


def test_axes() -> None:
    np.testing.assert_allclose(frames.direction(np.pi / 2, 0), [1, 0, 0], atol=1e-15)
    np.testing.assert_allclose(frames.direction(np.pi / 2, np.pi / 2), [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(frames.direction(0, 1.0), [0, 0, 1], atol=1e-15)


def test_wrap_where_it_wraps() -> None:
    assert frames.wrap(np.radians(355) - np.radians(5)) == pytest.approx(np.radians(-10))
    assert frames.wrap(np.pi) == -np.pi
    assert frames.angles([0.0, 0.0, 2.0])[1] == 0.0


@pytest.mark.parametrize("count", [1, 3, 300])
def test_nearest_points_are_a_trees(count: int) -> None:
    points = np.random.default_rng(count).normal(size=(count, 2))
    distances, numbers = frames.nearest(points, 4)
    expected, expected_numbers = cKDTree(points).query(points, range(1, min(4, count) + 1))
    np.testing.assert_array_equal(numbers, expected_numbers)
    np.testing.assert_allclose(distances, expected)


def test_a_point_is_the_nearest_to_itself_before_its_twin() -> None:
    distances, numbers = frames.nearest(np.array([[0.0, 1.0], [0.0, 1.0], [2.0, 1.0]]), 2)
    np.testing.assert_array_equal(numbers, [[0, 1], [1, 0], [2, 0]])
    np.testing.assert_array_equal(distances, [[0, 0], [0, 0], [0, 2]])
