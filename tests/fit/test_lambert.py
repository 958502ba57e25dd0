"""The diffuse term is bent to the facets, as the plugin bends it."""

import numpy as np
from synthetic_texels import sampled

from kinran.base import frames
from kinran.data.texel_directions import Under
from kinran.fit import lambert
from kinran_bsdf.models.lambert import diffuse

LIGHTS = frames.direction(
    *[a.ravel() for a in np.meshgrid(np.radians(np.arange(5, 75, 10)), np.radians(36.0 * np.arange(10)))]
)


def facets() -> tuple[np.ndarray, np.ndarray]:
    """T (60, 3, light) of facets by the plugin's formula, and their slopes."""
    rng = np.random.default_rng(0)
    slopes, colours = rng.uniform(-0.6, 0.6, (60, 2)), rng.uniform(0.1, 0.8, (60, 3))
    factor = diffuse(LIGHTS.T, slopes[:, :1], slopes[:, 1:])
    return (colours[:, :, None] * factor[:, None]).astype(np.float32), slopes


def test_facets_are_found_and_predicted() -> None:
    """A cosine to the cloth's own normal leaves 19 % of them."""
    T, slopes = facets()
    found = lambert.fit(sampled(T, LIGHTS))
    np.testing.assert_allclose(found.slopes, slopes, atol=1e-3)
    np.testing.assert_allclose(found.predict(Under.far(LIGHTS, len(T))), T, atol=1e-3)
    assert {"diffuse.x", "diffuse.y"} <= found.channels().keys()
    flat = (T @ LIGHTS[:, 2] / (LIGHTS[:, 2] @ LIGHTS[:, 2]))[..., None] * LIGHTS[:, 2]
    assert np.linalg.norm(flat - T) > 0.15 * np.linalg.norm(T)


def test_samples_that_are_not_finite_are_left_out() -> None:
    T, slopes = facets()
    T[:, 1, ::7] = np.nan
    np.testing.assert_allclose(lambert.fit(sampled(T, LIGHTS)).slopes, slopes, atol=1e-3)


def test_an_outlier_among_few_lights_makes_no_cliff() -> None:
    few = LIGHTS[[10, 14, 17]]
    T = np.full((1, 3, 3), 0.01, np.float32)
    T[..., 0] = 5
    found = lambert.fit(sampled(T, few))
    assert np.hypot(*found.slopes[0]) <= lambert.STEEPEST + 1e-9
