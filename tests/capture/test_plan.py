"""Plans: every direction once, whole shards, monitors spread, the quicker order."""

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinran.__main__ import main
from kinran.base.distances import Distances
from kinran.base.files import InputError
from kinran.base.frames import direction
from kinran.capture import grid
from kinran.data.capture_plan import Plan, read_plan, write_plan
from kinran.rig.motion import move_time

PAPER = [float(theta) for theta in range(0, 81, 5)]
BRACKET = [1 / 25, 1 / 100, 1 / 250, 1 / 1000, 1 / 4000]


@pytest.fixture(scope="module")
def paper() -> Plan:
    """The paper's grid."""
    return grid.plan_grid("gold", PAPER, 72, BRACKET, distances=Distances(600, 60))


def test_the_papers_grid(paper: Plan) -> None:
    """1153 distinct directions, 72 repeats of θ = 0: the paper's 1224 shots; four more tie the white plate to them."""
    assert len(paper.lights) == 1153
    assert paper.lights[-1].theta == 0
    shots = [shot for group in paper.groups for shot in group.shots]
    kinds = [shot.kind for shot in shots]
    assert kinds.count("light") == 1152
    assert kinds.count("monitor") == 72 + grid.CALIBRATION_MONITORS
    assert kinds[-7:] == ["dark", "white", "chart", *4 * ["monitor"]]
    assert len({shot.shot for shot in shots}) == len(shots)
    assert {shot.light for shot in shots if shot.kind == "light"} == set(range(1152))
    assert {shot.light for shot in shots if shot.kind == "monitor"} == {1152}
    assert [group.name for group in paper.groups] == grid.group_names(PAPER, 72)


def test_groups_are_whole_shards(paper: Plan) -> None:
    lights = [group.lights for group in paper.groups if group.lights]
    assert [len(each) for each in lights] == [64] * 17 + [65]
    assert [index for each in lights for index in each] == list(range(1153))
    for group in paper.groups[:-1]:
        shot = {shot.light for shot in group.shots}
        assert shot == {*group.lights, 1152}


def test_lights_say_where_they_are(paper: Plan) -> None:
    for light in paper.lights:
        expected = direction(math.radians(light.theta), math.radians(light.phi))
        np.testing.assert_allclose(light.direction, expected, atol=1e-12)
        assert light.position_mm is not None
        np.testing.assert_allclose(light.position_mm, 600 * expected, atol=1e-5)
    assert paper.lights[16].name == "t05_p005"
    assert paper.lights[16].grid == (1, 1)


def test_monitors_are_spread(paper: Plan) -> None:
    """The first and the last shot of a group, and the others evenly between them."""
    for group in paper.groups[:-1]:
        places = [i for i, shot in enumerate(group.shots) if shot.kind == "monitor"]
        assert len(places) == 4
        assert (places[0], places[-1]) == (0, len(group.shots) - 1)
        gaps = np.diff(places)
        assert max(gaps) - min(gaps) <= 1


@pytest.mark.parametrize("phis", [24, 72])
def test_order_is_as_quick_as_any(phis: int) -> None:
    """Travel through the directions of a group meets the minimum spanning tree, the bound of all orders."""
    shots = grid.plan_grid("gold", PAPER, phis, BRACKET).groups[3].shots
    poses = [(1000 * shot.theta, 1000 * shot.phi) for shot in shots if shot.kind == "light"]
    nearest = {pose: move_time(poses[0], pose) for pose in poses[1:]}
    bound = 0.0
    while nearest:
        pose = min(nearest, key=lambda each: nearest[each])
        bound += nearest.pop(pose)
        nearest = {other: min(time, move_time(pose, other)) for other, time in nearest.items()}
    assert sum(move_time(a, b) for a, b in pairwise(poses)) <= 1.01 * bound
    naive = sorted(poses, key=lambda pose: (pose[1], pose[0]))
    assert sum(move_time(a, b) for a, b in pairwise(naive)) > 1.1 * bound


def test_duration_and_dose(paper: Plan) -> None:
    bracket = sum(BRACKET) + 5 * grid.CAMERA_S
    assert paper.light_dose_s == pytest.approx(1228 * bracket)
    assert paper.duration_s is not None
    travel = paper.duration_s - 1231 * (bracket + 0.2)
    assert 12 * 60 < travel < 45 * 60


def test_same_input_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_plan(tmp_path / name, grid.plan_grid("gold", [0, 20, 40], 8, [0.04]))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_round_trip(tmp_path: Path, paper: Plan) -> None:
    write_plan(tmp_path / "plan.json", paper)
    again = read_plan(tmp_path / "plan.json")
    assert again == paper
    assert again.sha256 == paper.sha256


def test_whole_numbers_are_the_same_plan(tmp_path: Path) -> None:
    sizes = [Distances(lamp_mm) for lamp_mm in (600, 600.0)]
    plans = [grid.plan_grid("gold", [0, 20], 8, [1], meridians=8, distances=size) for size in sizes]
    assert plans[0].sha256 == plans[1].sha256
    write_plan(tmp_path / "plan.json", plans[0])
    assert read_plan(tmp_path / "plan.json").sha256 == plans[0].sha256


def test_an_edited_plan_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    write_plan(path, grid.plan_grid("gold", [0, 20], 8, [0.04], meridians=8))
    value = json.loads(path.read_text())
    value["exposures_s"] = [0.02]
    path.write_text(json.dumps(value))
    with pytest.raises(InputError, match="sha256"):
        read_plan(path)
    path.write_text("{}")
    with pytest.raises(InputError, match="is not a plan"):
        read_plan(path)


def test_names_of_finer_grids() -> None:
    plan = grid.plan_grid("gold", [0, 2.5], 16, [0.04], meridians=8)
    assert [light.name for light in plan.lights[:3]] == ["t02-5_p000", "t02-5_p022-5", "t02-5_p045"]
    assert plan.lights[-1].name == "t00_p000"


def test_a_small_grid_is_one_group() -> None:
    assert grid.group_lights([0, 40], 3) == {"00": range(4)}
    assert grid.group_lights([0, 40], 12, meridians=8) == {"00": range(8), "01": range(8, 13)}
    assert grid.group_names([0, 40], 3) == ["00", "calibration"]


@pytest.mark.parametrize(
    ("thetas", "phis", "meridians", "message"),
    [
        ([5, 10], 8, 4, "add 0"),
        ([0, 10, 10], 8, 4, "different"),
        ([0, 90], 8, 4, "under 90"),
        ([0, float("nan")], 8, 4, "different"),
        ([0], 8, 4, "different"),
        ([0, 10], 0, 4, "meridians from 1"),
        ([0, 10, 20, 30], 8, 4, "multiple of 8 meridians"),
        (PAPER, 72, 5, "at most 64"),
        (PAPER, 72, 0, "at most 64"),
    ],
)
def test_grids_that_cannot_be(thetas: list[float], phis: int, meridians: int, message: str) -> None:
    with pytest.raises(InputError, match=message):
        grid.group_names(thetas, phis, meridians)


@pytest.mark.parametrize("exposures", [[], [0.0], [-1.0], [float("nan")], [100.0]])
def test_exposures_that_cannot_be(exposures: list[float]) -> None:
    with pytest.raises(InputError, match="exposures"):
        grid.plan_grid("gold", [0, 10], 8, exposures)


def test_lengths_that_cannot_be() -> None:
    with pytest.raises(InputError, match="lamp-mm"):
        grid.plan_grid("gold", [0, 10], 8, [0.04], distances=Distances(lamp_mm=-1))
    with pytest.raises(InputError, match="field-mm"):
        grid.plan_grid("gold", [0, 10], 8, [0.04], distances=Distances(field_mm=math.inf))


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.json"
    words = ["--thetas", "0,20,40", "--phis", "8", "--exposures", "0.04,0.01", "--lamp-mm", "600"]
    assert main(["plan", "--fabric", "gold", *words, str(out)]) == 0
    assert read_plan(out).exposures_s == (0.04, 0.01)
    assert main(["plan", "--fabric", "../gold", *words, str(out)]) == 2
    assert "fabric '../gold'" in capsys.readouterr().err
