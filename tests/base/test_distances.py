"""Directions, falloff and half vectors per texel, of a lamp and a camera at finite distances."""

import numpy as np
import pytest

from kinran.base.distances import crop_centre, directions_to, falloff, relative_light, seen_from, texel_points
from kinran.calibrate.lamp import irradiance


def test_texels_are_centred() -> None:
    points = texel_points(4, 6, 0.5)
    assert points.shape == (4, 6, 3)
    np.testing.assert_allclose(points.mean((0, 1)), 0, atol=1e-12)
    np.testing.assert_allclose(points[0, 0], [-1.25, -0.75, 0])  # row 0 is v = 0


def test_the_lamp_is_near() -> None:
    """Over a field of 60 mm under a lamp at 600 mm the half vector turns by 4.3° at θ = 60°, and falloff is ±8 %."""
    points = texel_points(1, 601, 0.1)
    lamp = 600 * np.array([np.sin(np.pi / 3), 0, 0.5])
    light, view = directions_to(lamp, points), directions_to((0, 0, 600), points)
    np.testing.assert_allclose(np.linalg.norm(light, axis=-1), 1)
    np.testing.assert_allclose(light[0, 300], lamp / 600, atol=1e-12)
    slope = np.degrees(np.arctan2(*np.moveaxis((light + view)[0, [0, -1]][:, [0, 2]], 1, 0)))
    assert abs(np.ptp(slope)) == pytest.approx(4.3, abs=0.1)
    reach = falloff(lamp, points)[0]
    assert reach[300] == pytest.approx(1)
    assert reach[-1] / reach[0] == pytest.approx(
        (600**2 + 30**2 + 2 * 30 * lamp[0]) / (600**2 + 30**2 - 2 * 30 * lamp[0])
    )


def test_falloff_and_cosine_are_the_irradiance_of_a_plate() -> None:
    lamp = (200.0, -100.0, 500.0)
    points = texel_points(20, 30, 2.0)
    cosine = directions_to(lamp, points)[..., 2] / (500 / np.linalg.norm(lamp))
    np.testing.assert_allclose(falloff(lamp, points) * cosine, irradiance(lamp, 20, 30, 60.0), rtol=1e-6)


def test_the_middle_of_a_crop() -> None:
    """A crop at the top right corner of a photograph of 200 × 100 pixels, 400 mm wide: to the right, and up."""
    assert crop_centre((150, 0, 50, 20), (200, 100), 400.0) == (150.0, 80.0)
    assert crop_centre((0, 0, 200, 100), (200, 100), 400.0) == (0.0, 0.0)
    assert seen_from((0.0, 0.0, 300.0), (150.0, 80.0)) == (-150.0, -80.0, 300.0)


def test_equal_lamps_at_other_distances() -> None:
    np.testing.assert_allclose(relative_light([[0, 0, 100], [0, 300, 0], [200, 0, 0]]), [4, 4 / 9, 1])
    np.testing.assert_allclose(relative_light([[0, 0, 5], [0, 3, 4]]), 1)
