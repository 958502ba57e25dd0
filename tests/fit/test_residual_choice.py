"""Cross-validation chooses a residual where shadows ask for one, and none where the lobes say it all."""

import numpy as np
from synthetic_texels import radiance, sampled, texels

from kinran.base import frames
from kinran.base.encoding import parse
from kinran.fit import components, cross_validation, learned_priors, residual, slope
from kinran.fit.slope_lobes import Lobes


def choose(T: np.ndarray, lights: np.ndarray) -> residual.Choice:
    samples = sampled(T.astype(np.float32), lights)
    priors = learned_priors.region_priors(slope.fit(samples, Lobes()), samples, 1)
    return residual.cross_validate(samples, Lobes(), priors, "srgb")


def lights_of_a_dome(n: int = 60) -> np.ndarray:
    k = np.arange(n) + 0.5
    theta = np.arccos(1 - 0.75 * k / n)
    return frames.direction(theta, k * np.pi * (3 - 5**0.5))


def test_none_where_lobes_are_exact() -> None:
    lights = lights_of_a_dome()
    T = 0.2 * radiance(*texels(256), lights)
    assert choose(T, lights).components == 0


def test_some_where_shadows_fall() -> None:
    """Each texel is dark under light from its own side, below an angle of its own: no lobe can say that."""
    lights = lights_of_a_dome()
    rng = np.random.default_rng(0)
    side = rng.uniform(0, 2 * np.pi, 256)
    towards = np.stack([np.cos(side), np.sin(side)], 1) @ lights[:, :2].T
    shadow = 1 / (1 + np.exp(-12 * (0.3 - towards)))
    T = 0.2 * radiance(*texels(256), lights) * (0.1 + 0.9 * shadow[:, None])
    choice = choose(T, lights)
    assert choice.components > 0
    assert choice.psnr > choice.lobes_psnr + 1
    assert min(choice.by_theta.values()) <= choice.psnr <= max(choice.by_theta.values())


def test_what_is_promised_is_told_by_the_lights_angle() -> None:
    lights = frames.direction(np.radians([0.0, 24.9, 25, 60, 90]), np.zeros(5))
    assert residual.by_theta(np.array([1.0, 3, 5, 7, 9]), lights) == {"0 to 25": 2, "25 to 45": 5, "45 to 65": 7}


def test_saturated_samples_are_not_pulled_down_to_white() -> None:
    shown, lobes = np.array([[1.0, 0.4]]), np.array([[1.6, 0.5]])
    np.testing.assert_allclose(components.remainder(shown, lobes, "srgb", 1.0), [[0, -0.1]])
    np.testing.assert_allclose(components.remainder(shown, lobes, "log:2", 1.0), [[-0.6, -0.1]])


def test_principal_components_are_orthonormal_and_ordered() -> None:
    left = np.random.default_rng(0).normal(size=(12, 300)) * np.arange(12, 0, -1)[:, None]
    basis = components.principal(left, 5)
    np.testing.assert_allclose(basis.T @ basis, np.eye(5), atol=1e-10)
    strength = np.linalg.norm(basis.T @ left, axis=1)
    assert (np.diff(strength) < 0).all()


def test_encodings_of_photographs_are_domains_of_the_residual() -> None:
    """The same curve in both places."""
    from kinran_bsdf.residual import compress

    light = np.linspace(0, 1, 100, dtype=np.float32)
    for name in ("srgb", "linear", "gamma:2.2"):
        np.testing.assert_allclose(compress(light, name), parse(name).encode(light), atol=2e-6)


def test_neighbouring_lights_are_left_out_in_turn() -> None:
    """What is left out lies between what is not: hardly any light is outside of the others' hull, as at random."""
    lights = lights_of_a_dome()
    fold = cross_validation.deal(lights, 8)
    assert sorted(np.bincount(fold)) == [7, 7, 7, 7, 8, 8, 8, 8]
    nearest = np.argsort(np.linalg.norm(lights[:, None] - lights, axis=-1), axis=1)[:, 1]
    assert (fold != fold[nearest]).mean() > 0.9
    inside = [cross_validation.surrounded(lights[fold == k], lights[fold != k]).mean() for k in range(8)]
    assert min(inside) > 0.5


def test_lights_on_a_line_have_no_inside() -> None:
    line = frames.direction(np.linspace(0.1, 1.2, 9), np.zeros(9))
    assert not cross_validation.surrounded(line[::2], line[1::2]).any()


def test_few_lights_take_the_lobes_unless_something_is_surely_better() -> None:
    """The rule of standard errors: a mean that is better by chance changes nothing, a sure gain does."""
    rng = np.random.default_rng(0)
    alone = rng.normal(34, 3, 40)
    by_chance = {residual.ALONE: alone, (1.0, 4, 0.01): alone + 0.5 + 4 * (-1.0) ** np.arange(40)}
    assert residual.pick(by_chance).components == 0
    surely = {
        residual.ALONE: alone,
        (1.0, 4, 0.01): alone + 2,
        (0.5, 9, 0.01): alone + 2.1 + 2 * (-1.0) ** np.arange(40),
    }
    assert residual.pick(surely) == residual.Choice(1.0, 4, 0.01, float(np.mean(alone + 2)), float(alone.mean()))
    worse = {residual.ALONE: alone, (1.0, 4, 0.01): alone - 1, (0.5, 4, 0.01): alone - 2}
    assert residual.pick(worse).components == 0


def test_a_larger_share_that_does_not_pay_hides_none_that_does() -> None:
    """Of two that are level, the one with all of the lobes gains too little for its bytes."""
    alone = np.random.default_rng(0).normal(50, 1, 40)
    turns = (-1.0) ** np.arange(40)
    scores = {residual.ALONE: alone, (1.0, 4, 0.01): alone + 0.15, (0.5, 9, None): alone + 0.5 + 1.2 * turns}
    assert residual.pick(scores).smoothing is None
    assert residual.pick(scores).share == 0.5


def test_components_come_from_tiles_all_over_a_large_fabric() -> None:
    """62 × 92 tiles: a stride of 92 would take one column."""
    boxes = [(64 * y, 64 * y + 64, 64 * x, 64 * x + 64) for y in range(62) for x in range(92)]
    some = residual._some(boxes)
    assert residual.BASIS - 2 <= len(some) <= residual.BASIS
    rows, columns = {box[0] for box in some}, {box[2] for box in some}
    assert (len(rows), len(columns)) > (30, 30)
    assert residual._some(boxes[:64]) == boxes[:64]
