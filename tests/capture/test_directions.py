"""Sheets of directions: what they may say, what is refused by line and column, and that new rows change no group."""

from pathlib import Path

import pytest

from kinran.__main__ import main
from kinran.base.files import InputError
from kinran.capture.directions import plan_directions, read_directions
from kinran.data.capture_plan import read_plan, write_plan


def sheet(folder: Path, *rows: str, name: str = "sheet.tsv") -> Path:
    path = folder / name
    path.write_text("\n".join(rows).replace(" ", "\t") + "\n")
    return path


def lights(count: int, first: int = 0) -> list[str]:
    """Rows of different directions."""
    return [f"{5 + (7 * k) % 74} {(41 * k) % 360}.25" for k in range(first, first + count)]


def test_rows_become_lights_in_their_order(tmp_path: Path) -> None:
    """θ = 0 is the last light, shot as a monitor in every group, whether or not the sheet has it."""
    found = read_directions(sheet(tmp_path, "theta phi", "# a note", "20 350.5", "", "0 90", "40 -10", "12.5 0"))
    plan = plan_directions("silk", found, [0.04])
    assert [light.name for light in plan.lights] == ["t20_p350-5", "t40_p350", "t12-5_p000", "t00_p000"]
    assert [light.grid for light in plan.lights] == [None, None, None, (0, 0)]
    assert plan.kind == "directions"
    assert plan.groups[0].lights == (0, 1, 2, 3)
    kinds = [shot.kind for shot in plan.groups[0].shots]
    assert (kinds.count("light"), kinds.count("monitor")) == (3, 2)
    assert (found.group_names, found.count) == (["00", "calibration"], 4)


def test_commas_and_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "sheet.csv"
    path.write_bytes("\ufefftheta, phi\r\n20, 5\r\n40, 15\r\n".encode())
    assert [(each.theta, each.phi) for each in read_directions(path).groups["00"]] == [(20, 5), (40, 15)]


def test_further_rows_leave_full_groups_as_they_are(tmp_path: Path) -> None:
    """Names, lights, shots, poses and their order: what was shot of them counts."""
    before = plan_directions("silk", read_directions(sheet(tmp_path, "theta phi", *lights(130))), [0.04])
    after = plan_directions("silk", read_directions(sheet(tmp_path, "theta phi", *lights(200))), [0.04])
    assert [len(group.lights) for group in before.groups] == [64, 64, 3, 0]
    assert [len(group.lights) for group in after.groups] == [64, 64, 64, 9, 0]
    assert after.lights[:130] == before.lights[:130]
    for old, new in zip(before.groups[:2], after.groups[:2], strict=True):
        assert (old.name, old.lights) == (new.name, new.lights)
        assert [(s.shot, s.theta, s.phi) for s in old.shots] == [(s.shot, s.theta, s.phi) for s in new.shots]
    assert {s.shot for s in before.groups[2].shots} <= {s.shot for s in after.groups[2].shots}


def test_groups_of_the_sheet(tmp_path: Path) -> None:
    """A batch is a group, however small; the last one need not be whole shards."""
    rows = [f"{row} {0 if k < 16 else 1 if k < 24 else 2}" for k, row in enumerate(lights(27))]
    found = read_directions(sheet(tmp_path, "theta phi group", *rows))
    assert {name: len(own) for name, own in found.groups.items()} == {"00": 16, "01": 8, "02": 3}
    plan = plan_directions("silk", found, [0.04])
    write_plan(tmp_path / "plan.json", plan)
    assert read_plan(tmp_path / "plan.json") == plan


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([], "has no direction"),
        (["theta phi"], "has no direction"),
        (["theta phi", "0 0"], "theta over 0"),
        (["theta azimuth", "20 0"], "column 'azimuth' is none of"),
        (["theta", "20"], "has no column 'phi'"),
        (["theta phi", "20 0", "20"], "line 3 has another number of cells"),
        (["theta phi", "# note", "20 0", "x 10"], "line 4: theta 'x' is no number"),
        (["theta phi", "20 nan"], "line 2: phi nan is outside"),
        (["theta phi", "95 0"], "line 2: theta 95 is outside 0 to 90"),
        (["theta phi", "90 0"], "line 2: theta 90 is the horizon"),
        (["theta phi", "-20 0"], "line 2: theta -20 is outside"),
        (["theta phi", "20 0", "30 0", "20 360"], "line 4 has the direction of line 2 again"),
        (["theta phi", "0 0", "0 90"], "line 3 has the direction of line 2 again"),
        (["theta phi group", "20 0 0", "30 0 2"], "line 3 is of group 2 after group 0"),
        (["theta phi group", "20 0 1"], "line 2 is of group 1 after group 0"),
        (["theta phi group", "20 0 a"], "line 2: group 'a' is no whole number"),
        (["theta phi group", "20 0 0", "30 0 1"], "group 0 has 1 directions, but every group before"),
        (["theta phi group", *(f"{row} 0" for row in lights(65))], "line 66 is number 65 of group 0"),
        (["theta phi camera_theta camera_phi", "20 0  ", "20 0 30 "], "line 3: has camera_theta alone"),
        (["theta phi camera_theta camera_phi", "20 0  ", "20 0 80 0"], "line 3: camera_theta 80 is outside"),
        (["theta phi camera_theta camera_phi", "20 0  ", "20 0 0 0"], "line 3: camera_theta 0 is the front view"),
    ],
)
def test_sheets_that_cannot_be(tmp_path: Path, rows: list[str], says: str) -> None:
    path = sheet(tmp_path, *rows)
    with pytest.raises(InputError, match=says) as error:
        read_directions(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_shots_of_a_direction(tmp_path: Path) -> None:
    """At θ = 0 all monitors, since every group repeats it."""
    found = read_directions(sheet(tmp_path, "theta phi", "20 350.5", "40 10", *lights(70, 3)))
    assert found.find_shots(20, -9.5) == [("00", "t20_p350-5")]
    assert found.find_shots(20, 10) == []
    names = {(group.name, shot.shot) for group in plan_directions("silk", found, [0.04]).groups for shot in group.shots}
    monitors = found.find_shots(0, 0)
    assert len(monitors) == 4 + 2
    assert {*monitors, *found.find_shots(40, 10)} <= names


VIEWS = ["theta phi camera_theta camera_phi", "20 0  ", "45 90 30 0", "45 90 60 0", "45 90 60 180"]


def test_side_views_are_a_group(tmp_path: Path) -> None:
    """With the front view first, which is called as `kinran register` calls it; they are no lights of the stack."""
    plan = plan_directions("silk", read_directions(sheet(tmp_path, *VIEWS)), [0.04])
    assert [group.name for group in plan.groups] == ["00", "calibration", "views"]
    views = plan.group("views")
    assert views.lights == ()
    assert [shot.shot for shot in views.shots] == [
        "front",
        "view_t30_p000_under_t45_p090",
        "view_t60_p000_under_t45_p090",
        "view_t60_p180_under_t45_p090",
    ]
    assert [shot.camera for shot in views.shots] == [(0, 0), (30, 0), (60, 0), (60, 180)]
    assert {(shot.kind, shot.light, shot.theta, shot.phi) for shot in views.shots} == {("view", None, 45, 90)}
    write_plan(tmp_path / "plan.json", plan)
    assert read_plan(tmp_path / "plan.json") == plan
    assert plan.light_dose_s == pytest.approx((1 + 2 + 4 + 4) * 1.04)


def test_a_view_into_the_lamp_is_refused(tmp_path: Path) -> None:
    """The camera would stand where the light stands."""
    path = sheet(tmp_path, "theta phi camera_theta camera_phi", "20 0  ", "45 90 45 90")
    with pytest.raises(InputError, match=r"light arm at \(θ 45°, φ 90°\) meets the camera arm"):
        plan_directions("silk", read_directions(path), [0.04])


def test_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = sheet(tmp_path, *VIEWS), tmp_path / "plan.json"
    words = ["plan", "--fabric", "silk", "--exposures", "0.04", "--directions", str(path), str(out)]
    assert main(words) == 0
    rows = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert rows == ["group", "00", "calibration", "views", "all", "moves"]
    assert read_plan(out).group("views").shots[1].camera == (30, 0)
