"""Smooth functions of the light: thin plates over the angles, as a material can hold them."""

import numpy as np
import pytest

from benchmarks.texels import facets, microfacets
from kinran.base import frames
from kinran.fit.light_splines import plane, plates
from kinran_bsdf.residual import kernel_matrix, spline


@pytest.fixture
def lights() -> np.ndarray:
    theta, phi = (a.ravel() for a in np.meshgrid(np.radians(np.arange(10, 85, 12)), np.radians(np.arange(0, 360, 40))))
    return frames.direction(theta, phi + theta)


def at(nodes: np.ndarray, weights: np.ndarray, lights: np.ndarray) -> np.ndarray:
    return kernel_matrix(lights[:, :2], nodes) @ weights


def test_without_smoothing_they_go_through_the_values(lights: np.ndarray) -> None:
    values = np.random.default_rng(0).normal(size=(len(lights), 2))
    nodes, weights = plates(lights, values, 0.0)
    np.testing.assert_allclose(at(nodes, weights, lights), values, atol=1e-6)


def test_between_the_nodes_they_are_plates_over_the_angles(lights: np.ndarray) -> None:
    """The spline that a material holds says to 3 % of their spread what the plates say."""
    rng = np.random.default_rng(1)
    values = np.sin(3 * plane(lights)[:, :1]) + np.cos(2 * plane(lights)[:, 1:])
    others = frames.direction(rng.uniform(0.1, 1.35, 300), rng.uniform(0, 2 * np.pi, 300))
    direct = kernel_matrix(plane(others), plane(lights)) @ spline(plane(lights), values, 1e-2)
    wrong = at(*plates(lights, values, 1e-2), others) - direct
    assert wrong.std() < 0.03 * values.std()


def test_what_is_even_in_angle_stays_so_at_the_horizon(lights: np.ndarray) -> None:
    """Rings 12° apart of cos 3θ, seen between the last two: a spline over (l_x, l_y) alone is twice as far off."""
    values = np.cos(3 * frames.angles(lights)[0])[:, None]
    others = frames.direction(np.full(5, np.radians(76.0)), np.arange(5.0))
    truth = np.cos(3 * np.radians(76.0))
    flat = kernel_matrix(others[:, :2], lights[:, :2]) @ spline(lights, values, 0.0)
    assert np.abs(flat - truth).max() > 2 * np.abs(at(*plates(lights, values, 0.0), others) - truth).max()


def test_harmonics_are_smoother_between_rings_than_plates() -> None:
    """Rough microfacets under rings 20° apart, seen at 70°: plates are off by 5 % and more, harmonics by under 1 %."""
    theta, phi = (a.ravel() for a in np.meshgrid(np.radians([20, 40, 60, 80]), np.arange(12) * np.pi / 6))
    rings = np.concatenate([[[0, 0, 1]], frames.direction(theta, phi)])
    others = frames.direction(np.full(24, np.radians(70)), np.arange(24) * np.pi / 12 + 0.1)
    seen, truth = (microfacets(*facets(0.0, 20, 0.8), lights)[:, 0].T.astype(float) for lights in (rings, others))
    off = [np.sqrt(((at(*plates(rings, seen, s), others) / truth - 1) ** 2).mean()) for s in (0.0, None)]
    assert off[0] > 0.05
    assert off[1] < 0.01
