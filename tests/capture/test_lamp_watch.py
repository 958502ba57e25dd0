"""When the lamp is steady."""

import pytest

from kinran.capture import lamp_watch
from kinran.capture.lamp_watch import LOOK_S, STEADY_PER_MIN, WINDOW_S, Samples, drift_per_minute, warm_up
from kinran.rig.errors import RigError
from kinran.rig.firmware import Firmware
from kinran.rig.machine import WARM_UP_S, lamp_output
from kinran.rig.simulation import simulated_goniometer


def readings(until: float, seconds: float = WINDOW_S, drift: float = 0.0) -> Samples:
    """Looks at the simulated lamp, which drifts by a share in a minute more than it does."""
    count = int(seconds / LOOK_S) + 1
    times = [until - seconds + LOOK_S * k for k in range(count)]
    return [(at, 1e5 * lamp_output(at) * (1 + drift * (at - until) / 60)) for at in times]


def test_breathing_does_not_block_and_warming_does() -> None:
    """The worst slope of an hour and a half of breathing, over windows of two lengths; and that of the warm-up."""

    def worst(window: float, monkeypatch: pytest.MonkeyPatch) -> float:
        monkeypatch.setattr(lamp_watch, "WINDOW_S", window)
        starts = range(int(WARM_UP_S), int(WARM_UP_S) + 5400, 13)
        return max(abs(drift_per_minute(readings(start, window)) or 1.0) for start in starts)

    with pytest.MonkeyPatch.context() as patch:
        assert worst(WINDOW_S, patch) == pytest.approx(0.0011, abs=0.0001)
        assert worst(120.0, patch) == pytest.approx(0.0034, abs=0.0001)
    assert drift_per_minute(readings(600.0)) == pytest.approx(0.007, abs=0.001)


@pytest.mark.parametrize("drift", [0.004, -0.004])
def test_a_drift_is_measured(drift: float) -> None:
    assert drift_per_minute(readings(7200.0, drift=drift)) == pytest.approx(drift, abs=0.0012)


@pytest.mark.parametrize("seconds", [0.0, WINDOW_S / 2, WINDOW_S - 2 * LOOK_S])
def test_a_short_look_tells_nothing(seconds: float) -> None:
    assert drift_per_minute(readings(7200.0, seconds)) is None
    assert drift_per_minute([]) is None


def test_no_time_is_lost_after_the_warm_up() -> None:
    """The lamp is watched while it warms up."""
    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    rig.hello()
    rig.lamp(True)
    warm_up(rig, [])
    assert WARM_UP_S <= firmware.lamp_seconds < WARM_UP_S + 2 * LOOK_S


def test_a_lamp_that_drifts_is_waited_for() -> None:
    """A lamp that creeps by 0.5 % a minute until long after its warm-up."""
    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    rig.hello()
    rig.lamp(True)
    creeping: list[float | None] = []

    def creep(drift: float | None) -> None:
        creeping.append(drift)
        firmware.lamp_factor = 1 + 0.005 * min(firmware.lamp_seconds - 2400, 0) / 60

    warm_up(rig, [], say=creep)
    assert 2400 < firmware.lamp_seconds < 2400 + WINDOW_S + 2 * LOOK_S
    assert max(abs(drift or 0) for drift in creeping[-20:]) > STEADY_PER_MIN


def test_a_lamp_that_does_not_warm_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lamp_watch, "LIMIT_S", 300.0)
    rig = simulated_goniometer(Firmware())
    rig.hello()
    rig.lamp(True)
    with pytest.raises(RigError, match="still not warm after 5 minutes"):
        warm_up(rig, [])


def test_a_lamp_that_never_holds_steady(monkeypatch: pytest.MonkeyPatch) -> None:
    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    rig.hello()
    rig.lamp(True)
    monkeypatch.setattr(lamp_watch, "LIMIT_S", 2400.0)

    def creep(_: float | None) -> None:
        firmware.lamp_factor *= 1 - 0.005 * LOOK_S / 60

    with pytest.raises(RigError, match=r"drifting by 0\.\d% a minute after 40 minutes"):
        warm_up(rig, [], say=creep)


def test_a_lamp_that_was_steady_is_not_waited_for_again() -> None:
    """A second session, a minute after the first: its few readings would take minutes to tell anything."""
    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    rig.hello()
    rig.lamp(True)
    warm_up(rig, [])
    rig.wait(60)
    before = firmware.clock
    warm_up(rig, [], steady=True)
    assert firmware.clock - before < 1
    warm_up(rig, [])
    assert firmware.clock - before > WINDOW_S - 2 * LOOK_S
