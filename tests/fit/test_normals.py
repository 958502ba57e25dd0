"""Normals of a glossy, shadowed surface, where least squares fails."""

import numpy as np
import pytest
from synthetic_texels import sampled

from kinran.base import frames
from kinran.fit.lambert_normals import normals


@pytest.fixture
def surface() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """T (200, 3, 80) of tilted facets with a highlight each and some cast shadows; lights and true normals."""
    rng = np.random.default_rng(0)
    lights = frames.direction(
        *[a.ravel() for a in np.meshgrid(np.radians(np.arange(8, 72, 8)), np.radians(36.0 * np.arange(10)))]
    )
    truth = frames.direction(rng.uniform(0, 0.6, 200), rng.uniform(0, 2 * np.pi, 200))
    cosine = truth @ lights.T
    half = lights + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    T = 0.4 * np.maximum(cosine, 0) + 2.0 * np.maximum(truth @ half.T, 0) ** 200
    T[rng.random(T.shape) < 0.1] = 0
    return np.repeat(T[:, None], 3, 1).astype(np.float32), lights, truth


def error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.degrees(np.arccos(np.clip((found * truth).sum(1), -1, 1))).mean())


def test_highlights_and_shadows_do_not_bend_them(surface: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    T, lights, truth = surface
    plain = np.linalg.lstsq(lights, T.mean(1).T, rcond=None)[0].T
    assert error(plain / np.linalg.norm(plain, axis=1, keepdims=True), truth) > 5
    found = normals(sampled(T, lights))
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1)
    assert error(found, truth) < 1


def test_what_is_not_to_be_used_is_not(surface: tuple[np.ndarray, np.ndarray, np.ndarray]) -> None:
    T, lights, truth = surface
    W = np.ones((len(T), len(lights)), np.float32)
    W[:, ::2] = 0
    T[:, :, ::2] = 50
    assert error(normals(sampled(T, lights, W)), truth) < 2


def test_a_black_texel_faces_the_camera() -> None:
    lights = frames.direction(np.full(6, 0.5), np.arange(6.0))
    found = normals(sampled(np.zeros((1, 3, 6), np.float32), lights))
    np.testing.assert_array_equal(found, [[0, 0, 1]])


def test_lights_below_the_horizon_of_a_facet_say_nothing() -> None:
    """Facets tilted by 55° to 75° are dark under half of the lights: Lambert's law is not cos there, but 0."""
    rng = np.random.default_rng(2)
    lights = frames.direction(np.full(24, np.radians(50.0)), np.radians(15.0) * np.arange(24))
    truth = frames.direction(rng.uniform(np.radians(55), np.radians(75), 50), rng.uniform(0, 2 * np.pi, 50))
    T = np.repeat(0.4 * np.maximum(truth @ lights.T, 0)[:, None], 3, 1).astype(np.float32)
    assert error(normals(sampled(T, lights)), truth) < 1
