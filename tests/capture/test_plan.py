"""Plans of grids: every direction once, whole shards, the quick order, its table and its drawing."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinran.__main__ import main
from kinran.base.distances import Distances
from kinran.base.drawing.hemisphere import RADIUS
from kinran.base.files import InputError
from kinran.base.frames import direction
from kinran.capture import grid
from kinran.capture.arms import shots_time
from kinran.capture.assembly import CALIBRATION_MONITORS, CAMERA_S, FETCH_S, RIG, Rig
from kinran.capture.order import spanning_time
from kinran.capture.plan_drawing import draw_plan
from kinran.capture.plan_table import frame_bytes, plan_table
from kinran.data.capture_plan import Plan, read_plan, write_plan
from kinran.rig.motion import AXES, mdeg, with_motion

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
    assert kinds.count("monitor") == 72 + CALIBRATION_MONITORS
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


def test_monitors_stand_together_at_an_end(paper: Plan) -> None:
    """A trip to θ = 0 and back in mid-group takes 17 s; groups go up and down in turn, and meet there."""
    for up, group in zip([True, False] * 9, paper.groups[:-1], strict=True):
        places = [i for i, shot in enumerate(group.shots) if shot.kind == "monitor"]
        assert places == ([0, 1, 2, 3] if up else [64, 65, 66, 67])


def test_monitors_alone_follow_the_lamp_from_even_places() -> None:
    """Without a photodiode: the first and the last shot of a group, and the others evenly between them."""
    plan = grid.plan_grid("gold", PAPER, 8, BRACKET, rig=Rig(photodiode=False))
    for group in plan.groups[:-1]:
        places = [i for i, shot in enumerate(group.shots) if shot.kind == "monitor"]
        assert (places[0], places[-1]) == (0, len(group.shots) - 1)
        assert np.ptp(np.diff(places)) <= 1


def test_travel_of_the_whole_plan(paper: Plan) -> None:
    """Every move, calibration included, is 1.15 times the spanning tree of the grid's 1224 poses at most: 11.9 min.

    The order before went to θ = 0 in the middle of each group, and took 21.6 min.
    """
    bound = spanning_time([(mdeg(theta), mdeg(5 * p)) for p in range(72) for theta in PAPER])
    assert bound == pytest.approx(713, abs=1)
    lit = [shot for group in paper.groups[:-1] for shot in group.shots]
    assert shots_time(lit) < 1.12 * bound
    assert shots_time([shot for group in paper.groups for shot in group.shots]) < 1.15 * bound


def test_duration_and_dose(paper: Plan) -> None:
    bracket = sum(BRACKET) + 5 * CAMERA_S
    assert paper.light_dose_s == pytest.approx(1228 * bracket)
    travel = shots_time([shot for group in paper.groups for shot in group.shots])
    assert paper.duration_s == pytest.approx(1231 * (0.2 + bracket + 5 * FETCH_S) + travel, abs=0.01)


def test_duration_follows_the_rig() -> None:
    """Slower axes, and the steps that take up play, cost time."""
    plain = grid.plan_grid("gold", [0, 20, 40], 8, [0.04])
    slow = grid.plan_grid("gold", [0, 20, 40], 8, [0.04], rig=Rig(with_motion(AXES, (5, 15, 5, 15))))
    loose = grid.plan_grid("gold", [0, 20, 40], 8, [0.04], rig=Rig(backlash=2))
    plain_s, slow_s, loose_s = (float(plan.duration_s or 0) for plan in (plain, slow, loose))
    assert slow_s > plain_s + 10
    assert loose_s > plain_s + 2
    assert (plain.backlash, loose.backlash) == (0, 2)


@pytest.mark.parametrize("backlash", [-1, 6, float("nan")])
def test_backlash_that_cannot_be(backlash: float) -> None:
    with pytest.raises(InputError, match="backlash"):
        grid.plan_grid("gold", [0, 20, 40], 8, [0.04], rig=Rig(backlash=backlash))


def test_a_rig_that_does_not_reach_refuses() -> None:
    short = (replace(AXES[0], high=30_000), *AXES[1:])
    with pytest.raises(InputError, match="light θ = 40° is outside"):
        grid.plan_grid("gold", [0, 20, 40], 8, [0.04], rig=Rig(short))


def test_shots_of_a_direction() -> None:
    """As the plan has them; θ = 0 at a meridian is the monitor of this meridian, wherever the arm stands for it."""
    plan = grid.plan_grid("gold", [0, 22.5, 40], 16, [0.04])
    for group in plan.groups[:-1]:
        for shot in group.shots:
            if shot.kind == "light":
                assert grid.find_shots([0, 22.5, 40], 16, 4, shot.theta, shot.phi) == [(group.name, shot.shot)]
    assert grid.find_shots([0, 22.5, 40], 16, 4, 0, 112.5) == [("01", "monitor_6")]
    assert "monitor_6" in {shot.shot for shot in plan.group("01").shots}
    for theta, phi in ((20, 0), (40, 10), (40, 360), (40, -22.5)):
        assert grid.find_shots([0, 22.5, 40], 16, 4, theta, phi) == []


def test_older_plans_are_read() -> None:
    """With the digest that they have: a plan as it was written before cameras moved."""
    plan = read_plan(Path(__file__).parent / "plans" / "before_camera_poses.json")
    assert plan.sha256 == "92d93b833d9d09b847f5cbc4d4572843b36ca6e057cd38d906402217a3b14c65"
    assert (plan.backlash, plan.groups[0].shots[0].camera, plan.on_rig) == (0, None, True)


def test_table(paper: Plan) -> None:
    """Rows add up to the whole; lux hours stand where the lux are known."""
    header, *rows, whole, bound = plan_table(paper, RIG, 20_000_000, 2000).splitlines()
    assert " ".join(header.split()) == "group directions shots frames travel min time min light s lux h GB"
    cells = [row.split() for row in rows]
    assert [row[0] for row in cells] == [group.name for group in paper.groups]
    total = whole.split()
    assert total[:4] == ["all", "1153", "1231", "6155"]
    for column in (1, 2, 3):
        assert sum(int(row[column]) for row in cells) == int(total[column])
    assert float(total[5]) == pytest.approx((paper.duration_s or 0) / 60, abs=0.06)
    assert float(total[6]) == pytest.approx(paper.light_dose_s or 0, abs=0.6)
    assert float(total[7]) == pytest.approx((paper.light_dose_s or 0) * 2000 / 3600, rel=1e-3)
    assert float(total[8]) == pytest.approx(6155 * 0.02)
    assert "1.16 times the minimum spanning tree" in bound
    assert "lux h" not in plan_table(paper, RIG)


def test_disk_is_that_of_the_frames_so_far(tmp_path: Path) -> None:
    assert frame_bytes(tmp_path) == 20_000_000
    for name, size in (("00/a.cr2", 300), ("00/b.cr2", 700), ("01/c.part", 400)):
        path = tmp_path / "frames" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))
    assert frame_bytes(tmp_path) == 700


def test_drawing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A dot for each light, at its place, and the way of each group in its colour."""
    words = ["plan", "--fabric", "gold", "--thetas", "0,20,40", "--phis", "8", "--exposures", "0.04"]
    assert main([*words, "--draw", str(tmp_path / "plan.svg"), str(tmp_path / "plan.json")]) == 0
    assert "times the minimum spanning tree" in capsys.readouterr().out
    plan = read_plan(tmp_path / "plan.json")
    picture = draw_plan(plan)
    assert (tmp_path / "plan.svg").read_text().count("<circle") == sum(m.kind in ("dot", "ring") for m in picture.marks)
    light = next(m for m in picture.marks if "t40_p090" in m.text)
    top = next(m for m in picture.marks if "monitor_1" in m.text)
    assert light.points[0][0] == pytest.approx(top.points[0][0])
    assert top.points[0][1] - light.points[0][1] == pytest.approx(RADIUS * 40 / 90)
    ways = [m for m in picture.marks if m.kind == "line" and m.series]
    assert [(way.series, len(way.points)) for way in ways] == [("00", 12), ("01", 12)]
    assert len({way.colour for way in ways}) == 2
    assert main([*words, "--draw", str(tmp_path / "plan.gif"), str(tmp_path / "plan.json")]) == 2


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
        grid.plan_grid("gold", [0, 10], 8, exposures, 8)


def test_lengths_that_cannot_be() -> None:
    with pytest.raises(InputError, match="lamp-mm"):
        grid.plan_grid("gold", [0, 10], 8, [0.04], 8, distances=Distances(lamp_mm=-1))
    with pytest.raises(InputError, match="field-mm"):
        grid.plan_grid("gold", [0, 10], 8, [0.04], 8, distances=Distances(field_mm=math.inf))


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "plan.json"
    words = ["--thetas", "0,20,40", "--phis", "8", "--exposures", "0.04,0.01", "--lamp-mm", "600"]
    assert main(["plan", "--fabric", "gold", *words, str(out)]) == 0
    assert read_plan(out).exposures_s == (0.04, 0.01)
    assert main(["plan", "--fabric", "../gold", *words, str(out)]) == 2
    assert "fabric '../gold'" in capsys.readouterr().err
    assert main(["plan", "--fabric", "gold", *words, "--speeds", "10,30,0,30", str(out)]) == 2
    assert main(["plan", "--fabric", "gold", *words, "--directions", "sheet.tsv", str(out)]) == 2
    assert "takes the place of --thetas and --phis" in capsys.readouterr().err
