"""The driver against the simulated rig: the faults of docs/rig.md, on both back-ends."""

import signal
import threading
from collections.abc import Callable
from typing import Any

import pytest

from kinran.rig.errors import (
    DisconnectedError,
    FaultError,
    LimitError,
    OffTargetError,
    RebootedError,
    RefusedError,
    RigError,
    RigTimeoutError,
)
from kinran.rig.firmware import Firmware
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import AXES, with_motion
from kinran.rig.opening import RigSettings
from kinran.rig.protocol import Config, Fault, Flag, Opcode, Report, ReportId, State
from kinran.rig.simulated_lamp import WARM_UP_S
from kinran.rig.simulation import simulated_goniometer
from kinran.rig.transport import SimulatedHid


@pytest.fixture(params=["hidraw", "libusb"])
def firmware(request: pytest.FixtureRequest) -> Firmware:
    """A rig; its `backend` says through which library it is reached."""
    firmware = Firmware()
    firmware.backend = request.param  # type: ignore[attr-defined]
    return firmware


@pytest.fixture
def rig(firmware: Firmware) -> HidGoniometer:
    """A driver that has homed its rig."""
    rig = simulated_goniometer(firmware, firmware.backend)  # type: ignore[attr-defined]
    rig.hello()
    rig.home()
    return rig


def moves(firmware: Firmware) -> int:
    return sum(opcode is Opcode.MOVE for opcode, _ in firmware.jobs_done)


def test_a_session(rig: HidGoniometer, firmware: Firmware) -> None:
    state = rig.move(35_000, 120_000)
    assert max(abs(state.position[0] - 35_000), abs(state.position[1] - 120_000)) <= 5
    assert firmware.pose[0] == pytest.approx(35_000, abs=3)
    rig.lamp(True)
    rig.wait(WARM_UP_S)
    assert rig.status().has(Flag.LAMP_WARM)
    assert rig.intensity() == pytest.approx(100_000, rel=0.02)
    rig.shutter(True)
    assert firmware.shutter_open
    rig.close()
    assert not firmware.shutter_open
    assert firmware.lamp_on
    assert rig.retries == 0


@pytest.mark.parametrize("fault", ["drop_command", "drop_reply", "dup_reply", "late_reply", "corrupt"])
def test_a_bad_line_never_repeats_a_move(rig: HidGoniometer, firmware: Firmware, fault: Any) -> None:
    for i in range(4):
        firmware.inject(fault)
        rig.move(10_000 * (i + 1), 0)
    assert moves(firmware) == 4
    assert firmware.pose[0] == pytest.approx(40_000, abs=3)
    assert rig.retries == (0 if fault == "dup_reply" else 4)


def test_damaged_commands_are_sent_again(firmware: Firmware) -> None:
    class Noisy(SimulatedHid):
        damage = False

        def write(self, data: bytes) -> int:
            if self.damage:
                self.damage = False
                data = data[:30] + b"\xff" + data[31:]
            return super().write(data)

    handle = Noisy(firmware)
    rig = HidGoniometer(handle, lambda: firmware.clock, live=False)
    rig.hello()
    rig.home()
    handle.damage = True
    rig.move(10_000, 0)
    assert moves(firmware) == 1
    assert rig.retries == 1


def test_replies_to_others_are_passed_over(rig: HidGoniometer, firmware: Firmware) -> None:
    """Replies to an earlier command, or to a process that is gone, are waiting in the queue."""
    for seq in (1, rig._seq, rig._seq + 1):
        firmware.outbox.append(Report(ReportId.REPLY, seq, Opcode.LAMP, boot=firmware.boot).pack())
    rig.move(10_000, 0)
    assert moves(firmware) == 1
    assert rig.state.position[0] == pytest.approx(10_000, abs=20)


def test_a_new_process_forgets_what_was_queued(rig: HidGoniometer, firmware: Firmware) -> None:
    rig.move(10_000, 0)
    firmware.advance(100)
    again = simulated_goniometer(firmware)
    state = again.hello()
    assert state.position[0] == pytest.approx(10_000, abs=20)
    assert state.uptime_ms == pytest.approx(1000 * firmware.uptime, abs=20)


def test_a_host_that_died_leaves_a_rig_that_can_be_used(rig: HidGoniometer, firmware: Firmware) -> None:
    """The watchdog closes the shutter; the next host clears its fault, and need not home again."""
    rig.lamp(True)
    rig.shutter(True, 60)
    firmware.advance(3)
    assert not firmware.shutter_open
    again = simulated_goniometer(firmware)
    assert again.hello().fault == Fault.NONE
    again.move(10_000, 0)
    assert firmware.lamp_on


def test_a_host_that_comes_back_at_once_stops_what_runs(rig: HidGoniometer, firmware: Firmware) -> None:
    rig._command(Opcode.SHUTTER, b"\1\xff\xff\0\0")
    rig._command(Opcode.HOME, b"\x0f")
    again = simulated_goniometer(firmware)
    again.hello()
    assert not firmware.shutter_open
    again.home()
    again.move(10_000, 0)


def test_a_signal_waits_for_the_end_of_a_call(firmware: Firmware) -> None:
    """In a call of the kernel it would make hidapi fail, as if the rig were gone."""
    ticks: list[int] = []

    class Disturbed(SimulatedHid):
        def _tick(self) -> None:
            before = len(ticks)
            signal.raise_signal(signal.SIGUSR1)  # to this thread
            assert len(ticks) == before

        def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
            self._tick()
            return super().read(max_length, timeout_ms)

        def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
            self._tick()
            return super().get_feature_report(report_num, max_length)

    old = signal.signal(signal.SIGUSR1, lambda number, frame: ticks.append(number))
    try:
        rig = HidGoniometer(Disturbed(firmware), lambda: firmware.clock, live=False)
        rig.hello()
        rig.home()
    finally:
        signal.signal(signal.SIGUSR1, old)
    assert len(ticks) > 5


def test_lost_events_do_not_lose_the_end_of_a_job(rig: HidGoniometer, firmware: Firmware) -> None:
    """The event that ends the job never comes: the status over the control pipe tells."""

    def deaf() -> None:
        firmware.__class__.on_event(firmware)
        firmware.outbox.pop()

    firmware.on_event = deaf  # type: ignore[method-assign]
    assert rig.move(10_000, 0).position[0] == pytest.approx(10_000, abs=20)
    assert moves(firmware) == 1


def test_a_full_queue_is_no_harm(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.advance(300)
    assert rig.ping().uptime_ms == pytest.approx(1000 * firmware.uptime, abs=1100)
    assert rig.move(10_000, 0).position[0] == pytest.approx(10_000, abs=20)


def test_a_hung_firmware_is_a_timeout_soon(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.inject("hang")
    before = firmware.clock
    with pytest.raises(RigTimeoutError, match="does not answer"):
        rig.move(10_000, 0)
    assert firmware.clock - before < 2.5
    with pytest.raises(DisconnectedError):
        rig.status()


@pytest.mark.parametrize("when", ["command", "motion"])
def test_unplugged(rig: HidGoniometer, firmware: Firmware, when: str) -> None:
    if when == "command":
        firmware.inject("unplug")
    else:
        finish = firmware._timers
        at = firmware.clock + 1.0

        def pull() -> None:
            firmware.plugged = False
            firmware._timers = finish  # type: ignore[method-assign]

        timers: Callable[[], list[Any]] = lambda: [*finish(), (at, pull)]  # noqa: E731
        firmware._timers = timers  # type: ignore[method-assign]
    with pytest.raises(DisconnectedError, match="cable"):
        rig.move(80_000, 0)
    with pytest.raises(RigError):
        rig.status()
    rig.close()


def test_an_interrupted_read_is_no_disconnect(firmware: Firmware) -> None:
    """A signal makes hidraw's read fail; the rig is still there."""

    class Interrupted(SimulatedHid):
        signals = 3

        def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
            if self.signals:
                self.signals -= 1
                raise OSError("read error")
            return super().read(max_length, timeout_ms)

    rig = HidGoniometer(Interrupted(firmware), lambda: firmware.clock, live=False)
    rig.hello()
    rig.home()
    assert rig.state.homed == 0b1111


def test_zeros_for_a_feature_are_damaged(firmware: Firmware) -> None:
    class Broken(SimulatedHid):
        def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
            return [0] * 64

    rig = HidGoniometer(Broken(firmware), lambda: firmware.clock, live=False)
    with pytest.raises(RigError, match="IDENT is damaged"):
        rig.hello()


def test_another_protocol_is_refused(firmware: Firmware) -> None:
    class Newer(SimulatedHid):
        def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
            data = bytes(super().get_feature_report(report_num, max_length))
            report = Report.unpack(data)
            return list(Report(report.id, boot=report.boot, payload=b"\2" + report.payload[1:]).pack())

    rig = HidGoniometer(Newer(firmware), lambda: firmware.clock, live=False)
    with pytest.raises(RigError, match="protocol 2"):
        rig.hello()


def test_a_reboot_is_noticed_and_nothing_is_repeated_blindly(rig: HidGoniometer, firmware: Firmware) -> None:
    rig.move(10_000, 0)
    firmware.inject("reboot")
    with pytest.raises(RebootedError, match="home it"):
        rig.move(20_000, 0)
    assert moves(firmware) == 1
    rig.hello()
    with pytest.raises(RefusedError, match="NOT_HOMED"):
        rig.move(20_000, 0)
    rig.home()
    rig.move(20_000, 0)
    assert moves(firmware) == 2


def test_limits_are_checked_before_anything_is_sent(rig: HidGoniometer, firmware: Firmware) -> None:
    before = rig._seq
    with pytest.raises(LimitError, match=r"95°.*90°"):
        rig.move(95_000, 0)
    with pytest.raises(LimitError, match="light φ"):
        rig.move(0, -20_000)
    assert rig._seq == before


def test_a_stall_is_a_latched_fault_with_its_axis(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.inject("stall")
    with pytest.raises(FaultError, match="STALL on axis 0") as caught:
        rig.move(80_000, 0)
    assert caught.value.axis == 0
    stopped = firmware.pose
    with pytest.raises(FaultError):
        rig.move(10_000, 0)
    assert firmware.pose == stopped
    rig.clear()
    rig.move(10_000, 0)


@pytest.mark.parametrize("fault", [Fault.ESTOP, Fault.LAMP_OUT, Fault.LIMIT_SWITCH, Fault.OVERHEATED])
def test_faults_stop_everything(rig: HidGoniometer, firmware: Firmware, fault: Fault) -> None:
    rig.lamp(True)
    rig.shutter(True)
    firmware.trip(fault)
    assert not firmware.shutter_open
    assert firmware.lamp_on == (fault is not Fault.LAMP_OUT)
    with pytest.raises(FaultError, match=fault.name):
        rig.shutter(True)


def test_emergency_stop_in_a_move(rig: HidGoniometer, firmware: Firmware) -> None:
    rig.estop()
    with pytest.raises(FaultError, match="release the emergency stop"):
        rig.move(10_000, 0)


def test_the_door(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.set_interlock(True)
    with pytest.raises(RigError, match="INTERLOCK"):
        rig.move(10_000, 0)


def test_off_target_is_tried_once_more(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.inject("off_target")
    assert rig.move(10_000, 0).position[0] == pytest.approx(10_000, abs=20)
    assert moves(firmware) == 2


def test_off_target_twice_is_an_error(rig: HidGoniometer, firmware: Firmware) -> None:
    real = firmware._rest
    firmware._rest = lambda axis, target: real(axis, target) + 50  # type: ignore[method-assign]
    with pytest.raises(OffTargetError, match="instead of"):
        rig.move(10_000, 0)
    assert moves(firmware) == 2


def test_release_line(rig: HidGoniometer, firmware: Firmware) -> None:
    firmware.release = lambda seconds: firmware.sync()
    assert rig.release((0.04, 0.00025), gap_s=0.1).exposures == 2
    firmware.release = None
    with pytest.raises(FaultError, match="XSYNC_MISSING"):
        rig.release((0.04,), gap_s=0.1)


def test_heartbeat_thread_feeds_the_watchdog_of_a_live_rig() -> None:
    beats = threading.Semaphore(0)
    firmware = Firmware()

    class Counting(SimulatedHid):
        def write(self, data: bytes) -> int:
            if data[4] == Opcode.NOP:
                beats.release()
            return super().write(data)

    rig = HidGoniometer(Counting(firmware), lambda: firmware.clock, live=True)
    rig.hello()
    rig.shutter(True)
    assert beats.acquire(timeout=30)
    assert beats.acquire(timeout=30)
    rig.close()
    assert State.unpack(firmware.state().pack()).fault == Fault.NONE


def test_a_loaded_host_waits_as_long_as_replies_take(firmware: Firmware) -> None:
    class Slow(SimulatedHid):
        """Every reply is read 0.4 s after it came, as by a host that gets no time."""

        def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
            data = super().read(max_length, timeout_ms)
            if data and data[0] == ReportId.REPLY:
                self.firmware.advance(0.4)
            return data

    rig = HidGoniometer(Slow(firmware), lambda: firmware.clock, live=False)
    rig.hello()
    rig.home()
    before = rig.retries
    for _ in range(20):
        rig.move(10_000, 0)
        rig.move(0, 10_000)
    assert rig.retries == before
    assert moves(firmware) == 40


@pytest.mark.parametrize("slower", [2, 10])
def test_a_rig_that_is_slower_than_the_simulated_one_says_so(slower: int) -> None:
    axes = with_motion(
        AXES,
        [axis.speed / 1000 / slower for axis in AXES],
        [axis.acceleration / 1000 / slower for axis in AXES],
    )
    firmware = Firmware(axes=axes, homing_s=130)
    rig = simulated_goniometer(firmware)
    rig.hello()
    rig.home()
    rig.move(80_000, 350_000)
    assert firmware.pose[0] == pytest.approx(80_000, abs=20)
    assert rig.identity.axes == axes
    assert rig.identity.homing_s == 130


def test_a_rig_that_does_not_know_its_speeds_takes_the_configs() -> None:
    axes = with_motion(AXES, [2.0, 3.0, 2.0, 3.0], [2.0, 3.0, 2.0, 3.0])
    firmware = Firmware(axes=axes, homing_s=100)
    mute = Config(
        firmware._config.low,
        firmware._config.high,
        (0, 0, 0, 0),
        (0, 0, 0, 0),
        2000,  # as protocol 1.0 may be
    )
    firmware._config = mute
    rig = simulated_goniometer(firmware)
    rig.hello()
    with pytest.raises(RigTimeoutError, match="HOME takes longer"):
        rig.home()
    settings = RigSettings(speeds=[2, 3, 2, 3], accelerations=[2, 3, 2, 3], homing_s=100)
    rig = HidGoniometer(SimulatedHid(firmware), lambda: firmware.clock, False, settings.motion, settings.homing_s)
    rig.hello()
    rig.home()
    rig.move(80_000, 350_000)


def test_looking_changes_nothing(firmware: Firmware) -> None:
    other = simulated_goniometer(firmware)
    other.hello()
    other.home()
    other.shutter(True)
    handle = SimulatedHid(firmware)
    handle.write = None  # type: ignore[assignment, method-assign]
    seen = HidGoniometer(handle, lambda: firmware.clock, False)
    assert seen.look().has(Flag.SHUTTER)
    assert seen.identity.serial == "OGM-VIRTUAL"
    firmware.trip(Fault.STALL)
    assert seen.look().fault == Fault.STALL
    seen.close()
    assert firmware.state().fault == Fault.STALL


def test_closing_in_a_move_stops_the_arm(rig: HidGoniometer, firmware: Firmware) -> None:
    class StopHereError(Exception):
        pass

    listen, count = rig._listen, 0

    def interrupted(timeout_ms: int) -> Report | None:
        nonlocal count
        count += 1
        if count == 60:
            raise StopHereError
        return listen(timeout_ms)

    rig._listen = interrupted  # type: ignore[method-assign]
    with pytest.raises(StopHereError):
        rig.move(80_000, 350_000)
    rig.close()
    stands = firmware.pose
    assert 0 < stands[0] < 80_000
    firmware.advance(30)
    assert firmware.pose == stands
    assert not firmware.shutter_open


def test_arms_that_would_meet_are_not_sent(rig: HidGoniometer, firmware: Firmware) -> None:
    rig.move(60_000, 0, (0, 0))
    rig.move(60_000, 0, (30_000, 0))
    before = moves(firmware)
    with pytest.raises(LimitError, match="meets the camera arm"):
        rig.move(10_000, 0)
    with pytest.raises(LimitError, match="meets the camera arm"):
        rig.move(35_000, 0, (30_000, 0))
    assert moves(firmware) == before
    rig.move(60_000, 180_000)
    rig.move(10_000, 180_000)
