"""Orders: every shot once, near the bound of all orders, monitors where they cost least, the same each time."""

import itertools
import math
import random

import numpy as np
import pytest

from kinran.capture.arms import Pose, pose_of
from kinran.capture.grid import plan_grid
from kinran.capture.order import (
    improved,
    move_times,
    order_group,
    order_views,
    reorder,
    spanning_time,
    travel_time,
)
from kinran.data.capture_plan import Shot
from kinran.rig.motion import AXES, Four, mdeg, move_time, with_motion

PAPER = list(range(0, 81, 5))


def rig(theta: float, phi: float) -> Four:
    """Axes of these speeds in deg/s, which they reach in half a second."""
    return with_motion(AXES, (theta, phi), (2 * theta, 2 * phi))


def meridians(thetas: list[int], phis: int, first: int, last: int) -> list[Pose]:
    return [(mdeg(t), mdeg(360 * p / phis)) for p in range(first, last) for t in thetas if t]


def scattered(count: int, seed: int) -> list[Pose]:
    """Directions spread evenly over the hemisphere to 80°, in no order."""
    r = random.Random(seed)
    low = math.cos(math.radians(80))
    return [(mdeg(math.degrees(math.acos(r.uniform(low, 1)))), mdeg(r.uniform(0, 360))) for _ in range(count)]


def test_times_of_all_pairs() -> None:
    """As those of one move, on two axes and on four."""
    poses = [(0, 0, 0, 0), (5_000, 355_000, -30_000, 90_000), (80_000, 5_000, 0, 0), (5_000, 355_000, 10, 0)]
    for width in (2, 4):
        cut = [pose[:width] for pose in poses]
        found = move_times(cut, cut, rig(10, 30))
        expected = [[move_time(a, b, rig(10, 30)) for b in cut] for a in cut]
        np.testing.assert_allclose(found, expected, rtol=1e-12)


def test_spanning_tree() -> None:
    """Of a row, its length; of a star, its arms: a pose in the middle joins what is far apart."""
    row = [(5_000 * k, 0) for k in (0, 3, 1, 2)]
    assert spanning_time(row) == pytest.approx(3.0)
    star = [(40_000, 100_000), (45_000, 100_000), (35_000, 100_000), (40_000, 115_000), (40_000, 85_000)]
    assert spanning_time([*star, star[0]]) == pytest.approx(4.0)


def planned(groups: list[tuple[list[Pose], int]], axes: Four) -> list[list[tuple[int | None, Pose]]]:
    at, found = (0, 0), []
    for poses, monitors in groups:
        found.append(order_group(at, poses, monitors, axes))
        at = found[-1][-1][1]
    return found


@pytest.mark.parametrize(
    ("thetas", "phis", "speeds", "most"),
    [
        (PAPER, 72, (10, 30), 1.17),
        (PAPER, 72, (10, 10), 1.03),
        (PAPER, 72, (30, 10), 1.01),
        (PAPER, 24, (10, 30), 1.03),
        (PAPER, 24, (10, 10), 1.01),
        ([0, 20, 40, 60, 80], 8, (10, 30), 1.10),
        ([0, 20, 40, 60, 80], 8, (30, 10), 1.01),
    ],
)
def test_grids(thetas: list[int], phis: int, speeds: tuple[float, float], most: float) -> None:
    """All groups with their monitors, against the spanning tree of the plan's own poses in any groups."""
    axes = rig(*speeds)
    groups = [(meridians(thetas, phis, first, first + 4), 4) for first in range(0, phis, 4)]
    found = planned(groups, axes)
    for (poses, monitors), shots in zip(groups, found, strict=True):
        assert sorted(k for k, _ in shots if k is not None) == list(range(len(poses)))
        assert [pose[0] for k, pose in shots if k is None] == [0] * monitors
        assert all(pose == poses[k] for k, pose in shots if k is not None)
    way = [pose for shots in found for _, pose in shots]
    assert travel_time(way, axes) < most * spanning_time(way, axes)


@pytest.mark.parametrize("count", [20, 64])
def test_any_directions(count: int) -> None:
    """Within 13 % of the spanning tree; in the order of the list they take more than twice the time."""
    for seed in (1, 2):
        poses = scattered(count, seed)
        way = [pose for _, pose in order_group((0, 0), poses, 4)]
        assert len(way) == count + 4
        assert travel_time(way) < 1.13 * spanning_time(way)
        assert travel_time(poses) > 2 * travel_time(way)


def test_a_list_sorted_by_azimuth() -> None:
    """In groups of 64 it keeps within 15 % of the spanning tree of all; in no order each group crosses everything."""
    poses = scattered(256, 5)
    for listed, low, high in ((sorted(poses, key=lambda pose: pose[1]), 1.0, 1.15), (poses, 1.5, 2.0)):
        way = [
            pose for group in planned([(listed[k : k + 64], 4) for k in range(0, 256, 64)], AXES) for _, pose in group
        ]
        assert low < travel_time(way) / spanning_time(way) < high


def test_monitors_are_spread_where_it_costs_little() -> None:
    """With the quick θ inside, an order passes θ = 0 more often: half of the monitors at each end."""
    poses = meridians(PAPER, 72, 0, 4)
    places = [i for i, (k, _) in enumerate(order_group((0, 0), poses, 4, rig(30, 10))) if k is None]
    assert places == [0, 1, 66, 67]
    places = [i for i, (k, _) in enumerate(order_group((0, 0), poses, 4, rig(10, 30))) if k is None]
    assert places == [0, 1, 2, 3]


def test_play_turns_the_rows() -> None:
    """Rows go down in φ where a step up takes a detour."""
    poses = meridians(PAPER, 72, 0, 4)
    plain, loose = (order_group((0, 0), poses, 4, AXES, backlash) for backlash in (0, 1_000))
    ways = [[(0, 0), *(pose for _, pose in shots)] for shots in (plain, loose)]
    assert travel_time(ways[1], AXES, 1_000) < travel_time(ways[0], AXES, 1_000) - 10
    ups = [sum(b[1] > a[1] for a, b in itertools.pairwise(way)) for way in ways]
    assert ups[1] < ups[0] / 2


def test_steps_reach_the_best_order_of_a_few() -> None:
    """At most 1.5 % above the best of all 5040 orders of seven poses; 2-opt without Or-opt ends at 2.5 %."""
    for seed in range(20):
        poses = scattered(7, seed)
        times = move_times(poses, poses)
        every = np.array(list(itertools.permutations(range(7))))
        best = times[every[:, :-1], every[:, 1:]].sum(1).min()
        found = improved(np.arange(7), times)
        assert times[found[:-1], found[1:]].sum() <= 1.015 * best


def test_ends_stay() -> None:
    poses = scattered(12, 3)
    times = move_times(poses, poses)
    found = improved(np.arange(12), times, first=2, last=1)
    assert [*found[:2], found[-1]] == [0, 1, 11]
    assert sorted(found) == list(range(12))
    assert times[found[:-1], found[1:]].sum() < times[range(11), range(1, 12)].sum()


@pytest.fixture(scope="module")
def shots() -> list[Shot]:
    """Lights and monitors of the paper's grid in the order of their plan."""
    return [shot for group in plan_grid("gold", PAPER, 72, [0.04]).groups[:-1] for shot in group.shots]


@pytest.mark.parametrize(("count", "most"), [(20, 0.8), (60, 0.65), (150, 0.75)])
def test_what_is_missing_is_reordered(shots: list[Shot], count: int, most: float) -> None:
    """Against the order of the plan; the same each time."""
    missing = [shots[k] for k in sorted(random.Random(count).sample(range(len(shots)), count))]
    start = (40_000, 180_000, 0, 0)
    found = reorder(start, missing)
    assert sorted(shot.shot for shot in found) == sorted(shot.shot for shot in missing)
    seconds = [travel_time([start[:2], *map(pose_of, each)]) for each in (found, missing)]
    assert seconds[0] < most * seconds[1]
    assert reorder(start, missing) == found


def test_a_first_and_a_last_monitor_stay(shots: list[Shot]) -> None:
    pole, lights = shots[0], [shot for shot in shots if shot.kind == "light"]
    some = [pole, *lights[30:2:-3], shots[1]]
    found = reorder((0, 0, 0, 0), some)
    assert (found[0], found[-1]) == (some[0], some[-1])
    assert found != some
    free = reorder((80_000, 0, 0, 0), some[1:-1])
    assert free[0].theta > free[-1].theta


def test_a_whole_group_begins_at_the_nearer_end(shots: list[Shot]) -> None:
    lights = [shot for shot in shots[:68] if shot.kind == "light"]
    for start in ((0, 0, 0, 0), (80_000, 15_000, 0, 0)):
        found = reorder(start, lights)
        assert abs(mdeg(found[0].theta) - start[0]) <= 5_000


def test_other_subjects_keep_their_order() -> None:
    """A person changes them; and nothing or a single shot has no order."""
    calibration = plan_grid("gold", [0, 40], 8, [0.04], 8).groups[-1].shots
    assert reorder((45_000, 0, 0, 0), calibration) == list(calibration)
    assert reorder((0, 0, 0, 0), []) == []
    assert reorder((0, 0, 0, 0), calibration[-1:]) == list(calibration[-1:])


def test_views_keep_clear_of_the_light() -> None:
    """The straight way from one side of the light to the other would meet it; the order goes round, front first."""
    light = (60.0, 0.0)
    cameras = [(0.0, 0.0), (60.0, -30.0), (60.0, 30.0), (30.0, -60.0), (30.0, 60.0)]
    views = [Shot(f"v{k}", "view", None, *light, camera) for k, camera in enumerate(cameras)]
    found = order_views(views)
    assert found[0] == views[0]
    assert sorted(shot.shot for shot in found) == [shot.shot for shot in views]
    assert all({a.shot, b.shot} != {"v1", "v2"} for a, b in itertools.pairwise(found))
