"""Baselines of two lobes: each recovers itself, beats one lobe on two, and its derivatives are right."""

import numpy as np
import pytest
from lights_and_cloth import given, relative, said, shiny, spiral

from kinran.base import frames
from kinran.compare.baselines import crossed, lafortune, mixture, takeda_joint
from kinran.compare.baselines.separable import SeparableFit

LIGHTS, OTHERS = spiral(200), spiral(57, 75.0)


@pytest.mark.parametrize("name", ["lafortune", "crossed", "takeda"])
def test_derivatives_are_those_of_the_values(name: str) -> None:
    rng = np.random.default_rng(0)
    if name == "crossed":
        formula, p = crossed.families, rng.uniform([-0.3, -0.3, -2, 0.2], [0.3, 0.3, -1, 1.2], (6, 4))
    elif name == "takeda":
        formula, p = takeda_joint.lobe, rng.uniform([0.2, -2, -2, -1], [0.5, 2, -1, 0], (6, 4))
    else:
        formula, p = lafortune.lobe, rng.uniform([-0.5, -0.5, 1], [0.5, 0.5, 4], (6, 3))
    under = frames.slopes(LIGHTS), LIGHTS
    _, D = formula(p, *under)
    for k in range(p.shape[1]):
        step = np.zeros(p.shape[1])
        step[k] = 1e-6
        numeric = (formula(p + step, *under)[0] - formula(p - step, *under)[0]) / 2e-6
        np.testing.assert_allclose(D[:, k], numeric, atol=2e-7 + 1e-5 * np.abs(numeric).max())


def test_two_cosine_lobes_recover_themselves_where_one_cannot() -> None:
    rng = np.random.default_rng(1)
    n = 24
    shapes = np.stack(
        [
            np.column_stack([rng.uniform(-0.9, -0.4, n), rng.uniform(-0.3, 0.3, n), np.log(rng.uniform(20, 60, n))]),
            np.column_stack([rng.uniform(0.4, 0.9, n), rng.uniform(-0.3, 0.3, n), np.log(rng.uniform(5, 15, n))]),
        ],
        1,
    )
    made = SeparableFit(lafortune.lobe, shapes, rng.uniform(0.3, 1.0, (n, 3, 3)))
    samples, truth = given(said(made, LIGHTS), LIGHTS), said(made, OTHERS)
    one, two = (relative(said(fit(samples), OTHERS), truth) for fit in (lafortune.one, lafortune.two))
    assert made.numbers == 15
    assert two < 0.02
    assert one > 5 * two


def test_crossed_threads_recover_themselves() -> None:
    rng = np.random.default_rng(2)
    n = 24
    one = np.column_stack([rng.uniform(-0.2, 0.2, (n, 2)), np.full(n, np.log(0.12)), np.full(n, np.log(3.0))])
    made = SeparableFit(crossed.families, np.stack([one, one], 1), rng.uniform(0.3, 1.0, (n, 3, 3)))
    fitted = crossed.fit(given(said(made, LIGHTS), LIGHTS))
    assert relative(said(fitted, OTHERS), said(made, OTHERS)) < 0.02
    assert fitted.numbers == 17


def test_the_two_families_are_orthogonal() -> None:
    """Turned by 90° the first family of facets is the second."""
    p = np.array([[0.0, 0.0, np.log(0.1), np.log(4.0)]] * 2)
    turn = LIGHTS[:, [1, 0, 2]] * [-1, 1, 1]
    (G, _), (turned, _) = (crossed.families(p, frames.slopes(lights), lights) for lights in (LIGHTS, turn))
    np.testing.assert_allclose(turned[0], G[1], atol=1e-12)
    assert np.abs(G[0] - G[1]).max() > 0.3


def test_the_fresnel_factor_is_all_but_one_under_a_camera_at_the_normal() -> None:
    steep = frames.slopes(spiral(400, 80.0))
    assert crossed.fresnel(steep).min() >= 1
    assert crossed.fresnel(steep).max() < 1.02


@pytest.mark.parametrize("fit", [lafortune.two, crossed.fit])
@pytest.mark.parametrize("value", [0.0, 0.3, -1.0])
def test_constant_texels_are_finite(fit, value: float) -> None:
    T = np.full((3, 3, len(LIGHTS)), value, np.float32)
    found = fit(given(T, LIGHTS))
    assert np.isfinite(found.shapes).all()
    assert (found.colours >= 0).all()


@pytest.mark.parametrize("fit", [lafortune.one, lafortune.two, crossed.fit])
def test_samples_of_no_weight_do_not_count(fit) -> None:
    T, W = shiny(8, LIGHTS), np.ones((8, len(LIGHTS)), np.float32)
    spoilt, W[:, ::9] = T.copy(), 0
    spoilt[:, :, ::9] = 50
    predicted = [said(fit(given(t, LIGHTS, W)), OTHERS) for t in (T, spoilt)]
    np.testing.assert_allclose(predicted[0], predicted[1], atol=1e-4)


def test_a_mixture_follows_clusters_of_unequal_spread_that_kmeans_cuts() -> None:
    rng = np.random.default_rng(0)
    features = np.concatenate([rng.normal(0, 0.3, (500, 2)), rng.normal([4, 0], [2.0, 2.0], (500, 2))])
    truth = np.repeat([0, 1], 500)
    nearest = (np.linalg.norm(features[:, None] - [[0, 0], [4, 0]], axis=-1)).argmin(1)
    found = mixture.labels(features, nearest, 2)
    assert (found == truth).mean() > 0.97 > (nearest == truth).mean() + 0.005
