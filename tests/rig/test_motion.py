"""Trapezoid profiles."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinran.rig.motion import approach, move_time, travel_time, travelled


def test_known_times() -> None:
    """10°/s, 20°/s²: a ramp takes 0.5 s and 2.5°."""
    assert travel_time(5_000, 10_000, 20_000) == pytest.approx(1.0)
    assert travel_time(25_000, 10_000, 20_000) == pytest.approx(3.0)
    assert travel_time(-1_250, 10_000, 20_000) == pytest.approx(0.5)
    assert travel_time(0, 10_000, 20_000) == 0


def test_the_slowest_axis_sets_the_time() -> None:
    assert move_time((0, 0), (5_000, 15_000)) == pytest.approx(1.0)
    assert move_time((0, 0), (0, 15_000)) == pytest.approx(1.0)
    assert move_time((0, 0), (0, 90_000)) == pytest.approx(3.5)


@given(st.floats(1, 360_000), st.floats(1_000, 30_000), st.floats(1_000, 60_000))
def test_speed_and_acceleration_are_kept(distance: float, speed: float, acceleration: float) -> None:
    """Finite differences of the path stay under top speed, and the path is symmetric and ends at its end."""
    total = travel_time(distance, speed, acceleration)
    steps = 200
    path = [distance * travelled(distance, speed, acceleration, total * i / steps) for i in range(steps + 1)]
    assert path[0] == 0
    assert path[-1] == distance
    speeds = [(b - a) * steps / total for a, b in pairwise(path)]
    assert min(speeds) >= -1e-6 * distance
    assert max(speeds) <= speed * (1 + 1e-6)
    assert path[steps // 4] + path[-1 - steps // 4] == pytest.approx(distance, rel=1e-6)


def test_axes_arrive_from_above() -> None:
    """An axis that would come from below goes beyond its target first, while the others are already there."""
    assert approach((0, 0), (5_000, 5_000), 500) == [(5_500, 5_500), (5_000, 5_000)]
    assert approach((10_000, 10_000), (5_000, 5_000), 500) == [(5_000, 5_000)]
    assert approach((0, 10_000), (5_000, 5_000), 500) == [(5_500, 5_000), (5_000, 5_000)]
    assert approach((0, 0, 10_000, 0), (5_000, 0, 5_000, 90_000), 500)[0] == (5_500, 0, 5_000, 90_500)
    assert approach((0, 0), (5_000, 5_000), 0) == [(5_000, 5_000)]


def test_an_axis_that_stands_on_its_target_stays() -> None:
    assert approach((4_985, 5_012), (5_000, 5_000), 500) == [(5_000, 5_000)]


def test_approach_keeps_the_limits() -> None:
    """θ ends at 90°, φ at 370°: the play is taken up as far as there is room."""
    assert approach((0, 0), (89_800, 369_900), 500) == [(90_000, 370_000), (89_800, 369_900)]
    assert approach((0, 0), (90_000, 0), 500) == [(90_000, 0)]
    assert approach((5_000, 5_000), (0, -10_000), 500) == [(0, -10_000)]
