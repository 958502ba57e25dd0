"""The example of a bridge, before a fake serial port, and in a capture."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from fake_grbl import FakeGrbl

from examples.grbl_goniometer import GrblGoniometer
from kinran.rig.errors import (
    DisconnectedError,
    FaultError,
    LimitError,
    OffTargetError,
    RebootedError,
    RigError,
    RigTimeoutError,
)
from kinran.rig.goniometer import ALL_AXES, Goniometer
from kinran.rig.protocol import Fault, Flag

sys.path.append(str(Path(__file__).parents[1] / "fault"))
from capture_bench import Bench, check, small_plan


def meet(stage: FakeGrbl) -> GrblGoniometer:
    """A host that has said hello."""
    rig = GrblGoniometer(stage, "STAGE-7", clock=lambda: stage.clock, sleep=stage.sleep)
    rig.hello()
    return rig


@pytest.fixture
def stage() -> FakeGrbl:
    """A stage that was just switched on."""
    return FakeGrbl()


@pytest.fixture
def rig(stage: FakeGrbl) -> GrblGoniometer:
    """A stage that is homed."""
    rig = meet(stage)
    rig.home()
    return rig


def test_it_says_what_it_is(stage: FakeGrbl) -> None:
    rig = meet(stage)
    theta, phi, *_ = rig.identity.axes
    assert rig.identity.serial == "STAGE-7"
    assert (theta.speed, theta.acceleration) == (10_000, 20_000)
    assert (phi.speed, phi.acceleration) == (30_000, 60_000)
    assert not rig.identity.photodiode
    assert not rig.identity.x_sync
    assert rig.state.homed == 0
    assert rig.state.fault == Fault.NONE


def test_it_homes_and_moves(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    assert rig.state.homed == ALL_AXES
    state = rig.move(35_000, 120_000)
    assert state.position == (35_000, 120_000, 0, 0)
    assert stage.pose[:2] == (35_000, 120_000)
    assert state.moving == 0


def test_no_move_before_homing(stage: FakeGrbl) -> None:
    with pytest.raises(RigError, match="not homed"):
        meet(stage).move(10_000, 0)
    assert not [line for line in stage.lines if "G0" in line]


def test_limits_and_the_camera_arm_that_is_not_there(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    with pytest.raises(LimitError, match="outside"):
        rig.move(95_000, 0)
    with pytest.raises(LimitError, match="camera arm"):
        rig.move(10_000, 0, (30_000, 0))
    assert rig.move(10_000, 0, (0, 0)).position[0] == 10_000


def test_a_host_that_comes_back_need_not_home_again(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    boot = rig.identity.boot
    again = meet(stage)
    assert again.state.homed == ALL_AXES
    assert again.identity.boot == boot
    stage.switch_on()
    third = meet(stage)
    assert third.state.homed == 0
    assert third.identity.boot != boot


def test_a_host_that_comes_back_stops_what_runs(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.write(b"G21 G90 G53 G0 X80.000 Y0.000\nG21 G9")
    stage.sleep(2)
    again = meet(stage)
    assert again.state.moving == 0
    assert again.state.homed == ALL_AXES
    assert 10_000 < again.state.position[0] < 30_000
    assert again.move(10_000, 0).position[0] == 10_000


def test_stop_keeps_the_pose(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.write(b"G21 G90 G53 G0 X80.000 Y0.000\n")
    stage.sleep(2)
    state = rig.stop()
    at = stage.pose[0]
    stage.sleep(5)
    assert stage.pose[0] == at
    assert state.homed == ALL_AXES
    assert meet(stage).identity.boot == rig.identity.boot


def test_a_power_cut_is_noticed(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.switch_on()
    stage._state = "Idle"  # a controller that does not insist on homing
    with pytest.raises(RebootedError, match="home it"):
        rig.status()
    with pytest.raises(RigError, match="not homed"):
        rig.move(10_000, 0)
    rig.hello()
    assert rig.state.homed == 0
    rig.home()
    assert rig.move(10_000, 0).position[0] == 10_000


def test_a_limit_switch_is_a_fault_until_homing(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.hit_limit()
    with pytest.raises(FaultError, match="LIMIT_SWITCH"):
        rig.status()
    with pytest.raises(FaultError, match="LIMIT_SWITCH"):
        rig.move(10_000, 0)
    rig.home()
    assert rig.state.fault == Fault.NONE
    assert rig.move(10_000, 0).position[0] == 10_000


def test_an_arm_that_misses_its_target(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.off_target = 0.05
    with pytest.raises(OffTargetError, match="10050"):
        rig.move(10_000, 0)
    assert sum("X10.000" in line for line in stage.lines) == 2


def test_a_cable_that_comes_out(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.fails = True
    with pytest.raises(DisconnectedError, match="cable"):
        rig.move(10_000, 0)
    rig.close()
    assert stage.closed


def test_a_stage_that_says_nothing(stage: FakeGrbl, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stage, "_say", lambda *lines: None)
    with pytest.raises(RigTimeoutError, match="does not answer"):
        meet(stage)


def test_closing_stops_the_arm(rig: GrblGoniometer, stage: FakeGrbl) -> None:
    stage.write(b"G21 G90 G53 G0 X80.000 Y0.000\n")
    stage.sleep(2)
    rig.close()
    at = stage.pose[0]
    stage.sleep(5)
    assert stage.pose[0] == at
    assert stage.closed


def test_the_lamp_of_a_person_is_warm(rig: GrblGoniometer) -> None:
    assert not rig.state.has(Flag.LAMP_WARM)
    assert rig.lamp(True).has(Flag.LAMP_WARM)
    assert rig.shutter(True).has(Flag.SHUTTER)
    rig.wait(3)
    assert not rig.shutter(False).has(Flag.SHUTTER)
    assert rig.intensity() == 0


def test_a_capture_runs_through_it(stage: FakeGrbl, tmp_path: Path) -> None:
    """With no lamp, shutter, photodiode or X-sync: every frame is under its own direction."""
    bench = Bench(tmp_path)
    bench.camera.firmware = stage  # type: ignore[assignment]

    @contextmanager
    def devices() -> Iterator[tuple[Goniometer, object]]:
        rig = GrblGoniometer(stage, clock=lambda: stage.clock, sleep=stage.sleep)
        try:
            yield rig, bench.camera
        finally:
            rig.close()

    plan = small_plan()
    numbers = check(tmp_path, plan, bench.capture(plan, devices=devices))
    assert sorted(numbers) == list(range(48))
    assert bench.camera.card() == []
