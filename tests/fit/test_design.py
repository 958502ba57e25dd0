"""Optimal design: what a direction is expected to gain is what it gains, and doubt goes where nothing is known."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_texels import radiance, sampled, texels

from kinran.base import frames
from kinran.base.apart import spread
from kinran.fit import design, gauss_newton, learned_priors, slope
from kinran.fit.design import Known, Misfit
from kinran.fit.region_priors import Priors
from kinran.fit.slope_lobes import Lobes

COUNT = 12


def some_fit(lobes: Lobes, seed: int = 0) -> slope.SlopeFit:
    """Texels with random lobes, colours in one channel alone."""
    rng = np.random.default_rng(seed)
    one = np.stack([*rng.normal(0, 0.15, (2, COUNT)), *rng.normal((1.6, 0, 1.2), 0.2, (COUNT, 3)).T], 1)
    two = np.stack([*rng.normal(0, 0.15, (2, COUNT)), *rng.normal((0.5, 0, 0.7), 0.2, (COUNT, 3)).T], 1)
    shapes = np.concatenate([*[one, two][: lobes.count], rng.normal(0, 0.03, (COUNT, 2))], 1)
    colours = np.zeros((COUNT, lobes.count + 1, 3))
    colours[:, :, 0] = rng.uniform(0.3, 1, (COUNT, lobes.count + 1))
    return slope.SlopeFit(lobes, shapes, colours, np.ones(COUNT), np.zeros(COUNT, bool))


def known_of(fitted: slope.SlopeFit, taken: np.ndarray, stiffness: float = 1e-3) -> Known:
    count = len(fitted.shapes)
    return Known(
        fitted,
        taken,
        np.ones((count, len(taken))),
        np.full(count, 1e-3),
        np.full(fitted.shapes.shape, stiffness),
        np.linspace(0.5, 1.5, count),
    )


def even(judged: np.ndarray, square: float = 0.0, reach: float = 0.1) -> Misfit:
    return Misfit(reach, np.full(len(judged), square))


@pytest.mark.parametrize("lobes", [Lobes("gaussian", 1), Lobes("ggx", 1), Lobes("gaussian", 2), Lobes("ggx", 2)])
def test_gradients_are_those_of_predictions(lobes: Lobes, lights: np.ndarray) -> None:
    """By central differences of what a fit predicts, in double precision by the definition of the plugin."""
    fitted, step = some_fit(lobes), 1e-2
    J = design.gradients(fitted, lights)

    def predicted(shapes: np.ndarray, colours: np.ndarray) -> np.ndarray:
        of = replace(fitted, shapes=shapes, colours=colours)
        return of.predict(slope.Under.far(lights, COUNT))[:, 0].astype(float)

    for k in range(J.shape[2]):
        ends = []
        for sign in (1, -1):
            shapes, colours = fitted.shapes.copy(), fitted.colours.copy()
            if k < lobes.size:
                shapes[:, k] += sign * step
            else:
                colours[:, k - lobes.size, 0] += sign * step
            ends.append(predicted(shapes, colours))
        found = (ends[0] - ends[1]) / (2 * step)
        np.testing.assert_allclose(J[:, :, k], found, atol=0.02 * np.abs(found).max() + 1e-5)


def test_covariances_are_those_of_the_fit(lights: np.ndarray) -> None:
    """Of `gauss_newton`, where colours have one channel, up to the variance of a sample and the weak prior."""
    fitted = some_fit(Lobes("gaussian", 2))
    T = fitted.predict(slope.Under.far(lights, COUNT))
    T = (T + np.random.default_rng(1).normal(0, 0.03, T.shape)).astype(np.float32)
    samples = sampled(T, lights)
    size = fitted.lobes.size
    whole = gauss_newton.covariances(fitted, samples)
    at = [*range(size), *(size + 3 * k for k in range(3))]
    expected = whole[:, at][:, :, at]
    found = known_of(fitted, lights, 0.0).covariances()
    ratio = np.diagonal(found, axis1=1, axis2=2) / np.diagonal(expected, axis1=1, axis2=2)
    np.testing.assert_allclose(ratio / np.median(ratio, 1, keepdims=True), 1, rtol=0.05)


def test_a_lobe_that_nothing_saw_is_as_strong_as_others_may_be(lights: np.ndarray) -> None:
    """Its strength is unknown by twice what lobes have, and not by whatever the equations bear."""
    fitted = some_fit(Lobes())
    fitted.shapes[:, :5] = (0.5, 0, 4, 0, 4)
    variance = known_of(fitted, lights[lights[:, 0] < 0]).covariances()[:, -2, -2]
    strength = fitted.colours[:, 0, 0]
    np.testing.assert_allclose(variance, design.SPREAD**2 * (strength**2).mean(), rtol=0.2)


def test_samples_without_weight_say_nothing(lights: np.ndarray) -> None:
    known = known_of(some_fit(Lobes()), lights)
    half = replace(known, weights=known.weights * (np.arange(len(lights)) % 2))
    np.testing.assert_allclose(half.covariances(), known_of(known.fitted, lights[1::2]).covariances(), rtol=1e-6)


def test_what_is_expected_after_a_choice_is_what_a_new_start_expects(lights: np.ndarray) -> None:
    """Rank-one updates against all anew, with the directions chosen among those taken."""
    fitted, first = some_fit(Lobes()), spread(lights, 12)
    known, misfit = known_of(fitted, lights[first]), even(lights, 0.02)
    found = design.choose(known, misfit, lights, lights, 6)
    again = design.choose(known_of(fitted, lights[[*first, *found.chosen]]), misfit, lights, lights, 1)
    assert found.expected[-1] == pytest.approx(again.expected[0], rel=1e-3)
    assert (np.diff(found.expected) < 0).all()


def test_the_first_choice_is_the_best_of_all(lights: np.ndarray) -> None:
    fitted, first = some_fit(Lobes()), spread(lights, 12)
    misfit, candidates = even(lights, 0.001), lights[::9]
    found = design.choose(known_of(fitted, lights[first]), misfit, candidates, lights, 1)
    after = [
        design.choose(known_of(fitted, np.concatenate([lights[first], one[None]])), misfit, lights[:1], lights, 1)
        for one in candidates
    ]
    assert np.argmin([a.expected[0] for a in after]) == found.chosen[0]


def test_each_candidate_is_chosen_once(lights: np.ndarray) -> None:
    fitted = some_fit(Lobes())
    found = design.choose(known_of(fitted, lights[:12]), even(lights, 0.01), lights[:20], lights, 64)
    assert sorted(found.chosen) == list(range(20))


def test_what_was_never_seen_is_seen_next(lights: np.ndarray) -> None:
    """A lobe there would be unknown: the parameters of the lobes that were found say nothing of it."""
    taken, holes = lights[lights[:, 0] > 0.05], []
    for square in (0.0, 0.02):
        found = design.choose(known_of(some_fit(Lobes()), taken), even(lights, square), lights, lights, 16)
        seen = frames.slopes(np.concatenate([taken, lights[found.chosen]]))
        holes.append(np.linalg.norm(frames.slopes(lights)[:, None] - seen, axis=2).min(1).max())
    assert holes[1] < 0.8 * holes[0]


def test_more_where_fits_without_a_direction_were_wrong(lights: np.ndarray) -> None:
    taken = lights[spread(lights, 48)]
    there, shares = taken[:, 1] > 0.2, []
    for wrong in (np.full(48, 0.1), np.where(there, 0.3, 0.001)):
        misfit = Misfit.of(wrong, taken, lights, 64)
        found = design.choose(known_of(some_fit(Lobes()), taken), misfit, lights, lights, 16)
        shares.append(float((lights[found.chosen, 1] > 0.2).mean()))
    assert shares[1] >= shares[0] + 0.2
    assert misfit.square[lights[:, 1] > 0.5].mean() > 5 * misfit.square[lights[:, 1] < -0.2].mean()


def test_few_directions_are_enough_for_two_lobes(lights: np.ndarray) -> None:
    """With fewer samples than parameters, priors keep every covariance finite."""
    fitted = some_fit(Lobes("gaussian", 2))
    found = design.choose(known_of(fitted, lights[:4]), even(lights, 0.01), lights, lights, 8)
    assert np.isfinite(found.expected).all()


def test_narrow_lobes_draw_directions_to_their_flanks() -> None:
    """On texels that no fit assumes to be lobes, the choice lowers the true error more than even ones do."""
    theta, phi = np.mgrid[4:81:4, 0:360:10].reshape(2, -1)
    dense = frames.direction(*np.radians([theta, phi]))
    shapes, colours = texels(60)
    truth = radiance(shapes, colours, dense)

    def error(use: np.ndarray) -> float:
        samples = sampled(truth[:, :, use], dense[use])
        priors = learned_priors.learn_priors(samples, 1, Lobes())
        predicted = slope.fit(samples, Lobes(), priors).predict(slope.Under.far(dense, 60))
        return float(np.sqrt(((predicted - truth) ** 2).sum() / (truth**2).sum()))

    first = spread(dense, 16)
    samples = sampled(truth[:, :, first], dense[first])
    priors = Priors(learned_priors.learn_priors(samples, 1, Lobes()), np.ones(16, np.float32))
    found = design.propose(samples, Lobes(), priors, dense, dense, 8, np.ones(60))
    assert error(np.r_[first, found.chosen]) < 0.9 * error(spread(dense, 24))


def test_priors_without_weight_leave_a_choice(lights: np.ndarray) -> None:
    """As `kinran.fit.shrinkage` leaves them where a region has several shapes; and where a fit leaves no residual."""
    few = lights[spread(lights, 16)]
    samples = sampled(radiance(*texels(8), few), few)
    prior = replace(learned_priors.learn_priors(samples, 1, Lobes())[0], variance=0.0)
    for tried in (samples, replace(samples, T=np.full_like(samples.T, 0.3))):
        priors = Priors([prior], np.ones(16, np.float32))
        found = design.propose(tried, Lobes(), priors, lights, lights, 8, np.ones(8))
        assert np.isfinite(found.expected).all()
        assert len(set(found.chosen)) == 8


@pytest.mark.parametrize(("taken", "next_batch"), [(8, 8), (16, 8), (48, 16), (64, 16), (128, 32), (640, 64)])
def test_batches_are_whole_shards(taken: int, next_batch: int) -> None:
    assert design.batch(taken) == next_batch
