"""`kinran bench adaptive`: what its plans choose, its sums, and what it finds on a real set."""

from pathlib import Path

import numpy as np
import pytest
from trials import shiny_trial, with_samples

from benchmarks import adaptive
from benchmarks.adaptive import Point
from kinran.base import frames
from kinran.compare.trial import Trial


def noisy_trial() -> Trial:
    trial = shiny_trial().thinned(30)
    T = trial.samples.T
    noise = np.random.default_rng(0).standard_normal(T.shape, np.float32)
    return with_samples(trial, T=T * (1 + np.float32(0.02) * noise))


def test_plans_choose_each_direction_once() -> None:
    """So many of the training lights; held-out lights are no candidates."""
    trial = noisy_trial()
    directions = trial.samples.under.directions
    for use in (adaptive.adaptive(trial, 32), adaptive.grid(directions, 32)):
        assert len(set(use.tolist())) == 32
        assert use.max() < len(directions)
    np.testing.assert_array_equal(adaptive.adaptive(trial, 24), adaptive.adaptive(trial, 32)[:24])


def test_a_grid_is_regular() -> None:
    """Of a dense hemisphere it takes the normal, and rings at even θ with equally many azimuths."""
    dense = frames.direction(*np.radians(np.mgrid[0:81:1, 0:360:3].reshape(2, -1)))
    theta, _ = frames.angles(dense[adaptive.grid(dense, 49)])
    rings, counts = np.unique(np.degrees(theta).round(), return_counts=True)
    assert rings[0] == 0
    assert set(counts[1:]) <= {8, 9, 10}
    np.testing.assert_allclose(np.diff(rings), 80 / (len(rings) - 1), atol=1.01)


def test_every_plan_is_judged() -> None:
    points = adaptive.measure(noisy_trial(), "0")
    assert {(p.plan, p.count) for p in points} == {(plan, n) for plan in adaptive.PLANS for n in (16, 24, 32)}
    assert sum(p.plan == "random" for p in points) == 3 * adaptive.SEEDS
    words = adaptive.table("made here", points)
    assert "for the grid’s error" in words
    assert adaptive.draw({"made here": points}).svg("")


@pytest.mark.parametrize(
    ("error", "wanted"), [(0.4, 16), (0.2, 16), (0.1, 32), (0.1414, 22.6), (0.05, 64), (0.01, np.inf)]
)
def test_directions_that_an_error_takes(error: float, wanted: float) -> None:
    """Between two numbers by a power law."""
    curve = {16: (0.2, 1.0), 32: (0.1, 1.0), 64: (0.05, 1.0)}
    assert adaptive.needed(curve, error) == pytest.approx(wanted, rel=0.01)


def test_means_are_geometric() -> None:
    points = [Point("grid", 16, str(k), relative, 0.1) for k, relative in enumerate((0.1, 0.4))]
    assert adaptive._means(points, "relative")["grid"][16] == pytest.approx((0.2, 2.0))


@pytest.mark.real
def test_real_photographs(real_data: Path) -> None:
    """Icon with gold leaf: from 32 lights on, the adaptive plan is no worse than directions spread evenly."""
    offset, trial = next(adaptive.trials("item3", real_data, Path()))
    points = adaptive.measure(trial.thinned(100), offset, ("spread", "adaptive"))
    error = {(p.plan, p.count): p.display for p in points}
    assert error["adaptive", 32] < 1.1 * error["spread", 32]
    assert error["adaptive", 48] < 1.1 * error["spread", 48]
