"""Captures whose arms go to a shot by more than one pose: against play, and for side views."""

from pathlib import Path

import pytest
from capture_bench import EXPOSURES, Bench, check

from kinran.capture.assembly import Rig
from kinran.capture.brackets_taken import setup_digest
from kinran.capture.directions import Direction, Directions, plan_directions
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import Plan, Shot
from kinran.rig.hid_goniometer import HidGoniometer


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A rig and a camera with an empty card."""
    return Bench(tmp_path)


@pytest.fixture
def moves(monkeypatch: pytest.MonkeyPatch) -> list[tuple[tuple[int, ...], tuple[int, int]]]:
    """Pose before each move of the light arm, and its target."""
    found: list[tuple[tuple[int, ...], tuple[int, int]]] = []
    move = HidGoniometer.move

    def spy(rig: HidGoniometer, theta: int, phi: int, camera: tuple[int, int] | None = None) -> object:
        found.append((rig.state.position[:2], (theta, phi)))
        return move(rig, theta, phi, camera)

    monkeypatch.setattr(HidGoniometer, "move", spy)
    return found


def test_play_is_taken_up_from_above(bench: Bench, moves: list[tuple[tuple[int, ...], tuple[int, int]]]) -> None:
    plan = plan_grid("silk", [0, 30], 8, EXPOSURES, meridians=8, rig=Rig(backlash=1))
    check(bench.root, plan, bench.capture(plan))
    poses = {(round(1000 * shot.theta), round(1000 * shot.phi)) for shot in plan.groups[0].shots}
    last = [(start, target) for start, target in moves if target in poses]
    assert len(last) == 16
    assert len(moves) > 16
    for start, target in last:
        assert all(a >= b - 20 for a, b in zip(start, target, strict=True))


def test_the_camera_comes_back_from_its_views(bench: Bench) -> None:
    """The group of views stands where it says, and the lights that follow are seen along N."""
    light = Direction(45.0, 90.0)
    views = [(light, (30.0, 0.0)), (light, (60.0, 0.0))]
    plan = plan_directions("silk", Directions({"00": [light, Direction(20.0, 0.0)]}, views), EXPOSURES)
    seen = bench.capture(plan, "views")
    check(bench.root, plan, seen)
    poses = {shot["shot"]: shot["pose_mdeg"] for shot in seen["shots"]}
    assert poses["view_t60_p000_under_t45_p090"] == pytest.approx([45_000, 90_000, 60_000, 0], abs=20)
    assert poses["front"] == pytest.approx([45_000, 90_000, 0, 0], abs=20)
    after = bench.capture(plan, "00")
    check(bench.root, plan, after)
    assert all(abs(angle) <= 20 for shot in after["shots"] for angle in shot["pose_mdeg"][2:])


def test_set_ups_differ_by_the_camera() -> None:
    """And are those of earlier captures where it stands on N."""
    plan = Plan("silk", "grid", (0.04,), (), ())
    along, aside = (Shot("a", "light", 0, 20.0, 0.0, camera) for camera in (None, (30.0, 0.0)))
    assert setup_digest(plan, along, {"device": "fake"}) == "8820506808ce2c90"
    assert setup_digest(plan, aside, {"device": "fake"}) != setup_digest(plan, along, {"device": "fake"})
