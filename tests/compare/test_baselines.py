"""Each baseline recovers what it can hold, and fails where it must."""

import numpy as np
import pytest
from lights_and_cloth import given, relative, said, shiny, spiral

from kinran.compare.baselines import basis, codebook, components, interpolation, lafortune
from kinran.compare.baselines.separable import SeparableFit
from kinran.fit.harmonics import harmonics

LIGHTS, OTHERS = spiral(120), spiral(57, 75.0)
PLATE = interpolation.thin_plate(0.0)


@pytest.mark.parametrize(("name", "terms"), [("polynomial", 6), ("harmonics", 16)])
def test_a_linear_basis_recovers_itself(name: str, terms: int) -> None:
    chosen = harmonics(16) if name == "harmonics" else basis.polynomial
    values = np.random.default_rng(0).normal(size=(20, 3, terms)).astype(np.float32)
    made = basis.Weights(chosen, values)
    fitted = basis.fit(given(said(made, LIGHTS), LIGHTS), chosen)
    np.testing.assert_allclose(fitted.values, values, atol=2e-4)
    assert relative(said(fitted, OTHERS), said(made, OTHERS)) < 1e-4
    assert fitted.numbers == 3 * terms


def test_hemispherical_harmonics_are_orthonormal() -> None:
    """∫ H_i H_j dω over the hemisphere is the identity, by Gauss quadrature in cos θ and even azimuths."""
    z, weight = np.polynomial.legendre.leggauss(12)
    z, weight = (z + 1) / 2, weight / 2
    phi = np.arange(24) * 2 * np.pi / 24
    cosine, turn = np.meshgrid(z, phi, indexing="ij")
    sine = np.sqrt(1 - cosine**2)
    lights = np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], -1).reshape(-1, 3)
    H = harmonics(25)(lights)
    area = np.repeat(weight * 2 * np.pi / 24, 24)
    np.testing.assert_allclose(H.T @ (area[:, None] * H), np.eye(25), atol=1e-10)


def test_a_polynomial_cannot_hold_a_highlight() -> None:
    T = shiny(40, LIGHTS)
    smooth = basis.fit(given(T, LIGHTS), basis.polynomial)
    sharp = basis.fit(given(T, LIGHTS), harmonics(25), ridge=1e-6)
    assert relative(said(smooth, LIGHTS), T) > 1.5 * relative(said(sharp, LIGHTS), T)


def test_more_terms_than_lights_stay_finite() -> None:
    few = spiral(8)
    fitted = basis.fit(given(shiny(5, few), few), harmonics(16), ridge=1e-6)
    assert np.isfinite(said(fitted, OTHERS)).all()


@pytest.mark.parametrize("matrix", [interpolation.linear, PLATE])
def test_interpolation_passes_through_its_samples(matrix: interpolation.Matrix) -> None:
    T = shiny(10, LIGHTS)
    kept = interpolation.fit(given(T, LIGHTS), matrix)
    np.testing.assert_allclose(said(kept, LIGHTS), T, atol=1e-4)
    assert kept.numbers == 3 * len(LIGHTS)


@pytest.mark.parametrize("matrix", [interpolation.linear, PLATE, interpolation.thin_plate(0.01)])
def test_weights_of_an_interpolation_sum_to_one(matrix: interpolation.Matrix) -> None:
    outside = np.concatenate([OTHERS, spiral(40, 89.0)])
    np.testing.assert_allclose(matrix(LIGHTS, outside).sum(1), 1, atol=1e-8)


def test_linear_interpolation_is_exact_for_planes_over_slopes() -> None:
    s = lambda lights: lights[:, :2] / (1 + lights[:, 2:])  # noqa: E731
    plane = lambda lights: (2 + s(lights) @ [0.5, -1.0])[None, None].repeat(3, 1).astype(np.float32)  # noqa: E731
    kept = interpolation.fit(given(plane(LIGHTS), LIGHTS), interpolation.linear)
    np.testing.assert_allclose(said(kept, OTHERS), plane(OTHERS), rtol=1e-5)


def test_thin_plate_is_exact_for_planes_and_better_than_linear_on_a_lobe() -> None:
    plane = lambda lights: (lights @ [0.3, 0.2, 0.0] + 1)[None, None].repeat(3, 1).astype(np.float32)  # noqa: E731
    kept = interpolation.fit(given(plane(LIGHTS), LIGHTS), PLATE)
    np.testing.assert_allclose(said(kept, OTHERS), plane(OTHERS), rtol=1e-5)
    T, truth = shiny(20, LIGHTS), shiny(20, OTHERS)
    kept = [interpolation.fit(given(T, LIGHTS), matrix) for matrix in (PLATE, interpolation.linear)]
    error = [relative(said(k, OTHERS), truth) for k in kept]
    assert error[0] < error[1] < 0.1


def test_two_lights_on_a_line_interpolate_by_distance() -> None:
    two = spiral(2)
    np.testing.assert_allclose(interpolation.linear(two, two), np.eye(2), atol=1e-6)


@pytest.mark.parametrize("texels", [30, 900])
def test_all_components_are_exact(texels: int) -> None:
    """At full rank nothing is lost, from either Gram matrix."""
    lights = spiral(40)
    T = shiny(texels, lights)
    fitted = components.fit(given(T, lights), 120, interpolation.linear)
    np.testing.assert_allclose(said(fitted, lights), T, atol=2e-3)
    assert fitted.numbers == min(texels, 120)
    flat = fitted.components.reshape(len(fitted.components), -1)[:20]
    np.testing.assert_allclose(flat @ flat.T, np.eye(len(flat)), atol=1e-3)


def test_fewer_components_are_worse_and_cheaper() -> None:
    T = shiny(400, LIGHTS)
    fits = [components.fit(given(T, LIGHTS), k, PLATE) for k in (2, 8, 16)]
    errors = [relative(said(f, LIGHTS), T) for f in fits]
    assert errors[0] > 1.4 * errors[1]
    assert errors[1] > 1.4 * errors[2]
    assert [f.numbers for f in fits] == [2, 8, 16]


def test_codebook_is_exact_for_as_many_kinds_of_texel_as_it_has_codes() -> None:
    kinds = shiny(6, LIGHTS)
    rng = np.random.default_rng(1)
    T = kinds[np.arange(600) % 6] * rng.uniform(0.5, 2, (600, 1, 1)).astype(np.float32)
    fitted = codebook.fit(given(T, LIGHTS), 64, PLATE)
    assert relative(said(fitted, LIGHTS), T) < 1e-3
    again = codebook.fit(given(T, LIGHTS), 64, PLATE)
    np.testing.assert_array_equal(fitted.code, again.code)
    one = codebook.fit(given(T, LIGHTS), 1, PLATE)
    assert relative(said(one, LIGHTS), T) > 0.1


def test_lafortune_recovers_itself() -> None:
    rng = np.random.default_rng(0)
    shapes = np.concatenate([rng.uniform(-0.7, 0.7, (60, 2)), np.log(rng.uniform(3, 200, (60, 1)))], 1)
    made = SeparableFit(lafortune.lobe, shapes[:, None], rng.uniform(0.2, 1.0, (60, 2, 3)))
    dense = spiral(400)
    fitted = lafortune.one(given(said(made, dense), dense))
    error = np.abs(fitted.shapes[:, 0] - shapes).max(1)
    assert np.median(error) < 1e-3
    assert relative(said(fitted, OTHERS), said(made, OTHERS)) < 0.02
    assert fitted.numbers == 9


@pytest.mark.parametrize("value", [0.0, 0.3, -1.0, 1e6])
def test_lafortune_of_constant_texels_is_finite(value: float) -> None:
    T = np.full((3, 3, len(LIGHTS)), value, np.float32)
    fitted = lafortune.one(given(T, LIGHTS))
    assert np.isfinite(said(fitted, OTHERS)).all()
    assert (fitted.colours >= 0).all()


def test_lafortune_scales_with_the_samples() -> None:
    T = shiny(10, LIGHTS)
    small, large = (lafortune.one(given(scale * T, LIGHTS)) for scale in np.float32([1, 1000]))
    np.testing.assert_allclose(large.colours, 1000 * small.colours, rtol=1e-3, atol=1e-3)
