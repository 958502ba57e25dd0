"""The simulated firmware, spoken to in bytes."""

import struct

import pytest

from kinran.rig.firmware import Firmware
from kinran.rig.machine import HOMING_S, WARM_UP_S, lamp_output
from kinran.rig.protocol import (
    VALIDATE_ONLY,
    Config,
    Expose,
    Fault,
    Flag,
    Ident,
    JobState,
    Move,
    Opcode,
    Report,
    ReportId,
    State,
    Status,
    estop_report,
)


class Host:
    """The plainest host: it sends a command and looks for its reply."""

    def __init__(self) -> None:
        self.firmware = Firmware()
        self.seq = 0
        self.hello()

    def hello(self) -> None:
        self.boot = 0
        self.boot = self.send(Opcode.HELLO, b"\0\0\0\0").boot
        self.send(Opcode.WATCHDOG, struct.pack("<I", 0))

    def raw(self, data: bytes) -> list[Report]:
        self.firmware.outbox.clear()
        self.firmware.on_output(data)
        reports = [Report.unpack(each) for each in self.firmware.outbox]
        return [report for report in reports if report.id == ReportId.REPLY]

    def command(self, opcode: Opcode, payload: bytes = b"", flags: int = 0) -> bytes:
        self.seq += 1
        return Report(ReportId.COMMAND, self.seq, opcode, flags, boot=self.boot, payload=payload).pack()

    def send(self, opcode: Opcode, payload: bytes = b"", flags: int = 0) -> Report:
        (reply,) = self.raw(self.command(opcode, payload, flags))
        return reply

    def home(self) -> None:
        assert self.send(Opcode.HOME, b"\x0f").code == Status.ACCEPTED
        self.firmware.advance(HOMING_S)

    def move(self, *targets: int, mask: int = 3) -> Report:
        four = (*targets, 0, 0, 0, 0)[:4]
        return self.send(Opcode.MOVE, Move(mask, (four[0], four[1], four[2], four[3])).pack())

    def state(self) -> State:
        return State.unpack(self.send(Opcode.NOP).payload)


@pytest.fixture
def host() -> Host:
    """A host that has said hello to a homed rig."""
    host = Host()
    host.home()
    return host


def test_no_motion_before_homing() -> None:
    host = Host()
    assert host.move(10_000, 0).code == Status.NOT_HOMED
    host.home()
    assert host.move(10_000, 0).code == Status.ACCEPTED


def test_a_move_ends_near_its_target_and_the_same_way_each_time(host: Host) -> None:
    poses = []
    for theta, phi in [(35_000, 120_000), (0, 0), (35_000, 120_000)]:
        host.move(theta, phi)
        host.firmware.advance(30)
        poses.append((host.firmware.pose[:2], host.state().position[:2]))
        true, encoders = poses[-1]
        assert max(abs(true[0] - theta), abs(true[1] - phi)) <= 3
        assert max(abs(encoders[0] - true[0]), abs(encoders[1] - true[1])) <= 2.5
    assert poses[0] == poses[2]
    assert poses[0][0] != (35_000, 120_000)


def test_all_axes_are_under_way_together(host: Host) -> None:
    host.move(10_000, 10_000)
    host.firmware.advance(0.7)
    theta, phi = host.firmware.pose[:2]
    assert 1000 < theta < 9000
    assert theta == pytest.approx(phi, abs=10)
    assert host.state().moving == 0b0011


@pytest.mark.parametrize("target", [(-1, 0), (90_001, 0), (0, 370_001), (0, -10_001)])
def test_soft_limits(host: Host, target: tuple[int, int]) -> None:
    before = host.firmware.pose
    assert host.move(*target).code == Status.LIMIT
    host.firmware.advance(10)
    assert host.firmware.pose == before


def test_arms_do_not_meet_on_the_way(host: Host) -> None:
    """The light arm may not pass a camera arm that left N, though both ends of the move are clear."""
    host.move(60_000, 0)
    host.firmware.advance(30)
    assert host.move(0, 0, 30_000, mask=4).code == Status.ACCEPTED
    host.firmware.advance(30)
    assert host.move(10_000, 0).code == Status.COLLISION
    assert host.move(35_000, 0).code == Status.COLLISION
    assert host.move(45_000, 0).code == Status.ACCEPTED


def test_one_seq_is_executed_once(host: Host) -> None:
    command = host.command(Opcode.MOVE, Move(3, (10_000, 0, 0, 0)).pack())
    first = host.raw(command)
    host.firmware.advance(30)
    jobs = len(host.firmware.jobs_done)
    assert host.raw(command) == first
    host.firmware.advance(30)
    assert len(host.firmware.jobs_done) == jobs
    host.seq -= 1
    assert host.move(20_000, 0).code == Status.BAD_SEQ


def test_hello_is_heard_although_its_seq_was_used(host: Host) -> None:
    """A new process starts to count where an earlier one may have stopped."""
    host.seq -= 1
    host.hello()
    assert host.boot == host.firmware.boot


def test_damaged_commands_are_not_executed(host: Host) -> None:
    command = bytearray(host.command(Opcode.LAMP, b"\1"))
    command[12] = 0
    (reply,) = host.raw(bytes(command))
    assert reply.code == Status.BAD_CRC
    assert not host.firmware.lamp_on


def test_wrong_payload_and_opcode(host: Host) -> None:
    assert host.send(Opcode.MOVE, b"\1").code == Status.BAD_ARG
    reply = host.raw(Report(ReportId.COMMAND, 9999, 0x77, boot=host.boot).pack())
    assert reply[0].code == Status.UNSUPPORTED


def test_commands_of_an_earlier_boot_are_stale(host: Host) -> None:
    host.firmware.reboot()
    assert host.send(Opcode.LAMP, b"\1").code == Status.STALE_BOOT
    assert not host.firmware.lamp_on
    assert host.state().homed == 0


def test_validate_only_moves_nothing(host: Host) -> None:
    ok, bad = Move(3, (10_000, 0, 0, 0)), Move(3, (99_000, 0, 0, 0))
    assert host.send(Opcode.MOVE, ok.pack(), VALIDATE_ONLY).code == Status.OK
    assert host.send(Opcode.MOVE, bad.pack(), VALIDATE_ONLY).code == Status.LIMIT
    host.firmware.advance(5)
    assert host.firmware.pose[0] < 10


def test_busy_while_a_job_runs(host: Host) -> None:
    host.move(80_000, 0)
    assert host.move(10_000, 0).code == Status.BUSY
    assert host.send(Opcode.STOP).code == Status.OK
    state = host.state()
    assert state.job_state == JobState.STOPPED
    assert state.position[0] < 80_000


def test_watchdog_closes_the_shutter_and_leaves_the_lamp_lit(host: Host) -> None:
    host.send(Opcode.WATCHDOG, struct.pack("<I", 2000))
    host.send(Opcode.LAMP, b"\1")
    host.send(Opcode.SHUTTER, struct.pack("<BI", 1, 60_000))
    host.firmware.advance(1.9)
    assert host.firmware.shutter_open
    host.send(Opcode.NOP)
    host.firmware.advance(1.9)
    assert host.firmware.shutter_open
    host.firmware.advance(0.2)
    assert not host.firmware.shutter_open
    assert host.firmware.lamp_on
    assert host.state().fault == Fault.WATCHDOG


def test_watchdog_stops_motion(host: Host) -> None:
    host.send(Opcode.WATCHDOG, struct.pack("<I", 2000))
    host.move(80_000, 0)
    host.firmware.advance(20)
    assert 5_000 < host.firmware.pose[0] < 70_000
    assert host.state().job_state == JobState.FAULTED


def test_the_shutter_closes_by_itself(host: Host) -> None:
    host.send(Opcode.SHUTTER, struct.pack("<BI", 1, 500))
    host.firmware.advance(0.6)
    assert not host.firmware.shutter_open


def test_emergency_stop_latches_until_it_is_named(host: Host) -> None:
    host.send(Opcode.SHUTTER, struct.pack("<BI", 1, 60_000))
    host.raw(estop_report())
    assert not host.firmware.shutter_open
    assert host.move(10_000, 0).code == Status.FAULTED
    assert host.send(Opcode.CLEAR, struct.pack("<H", Fault.STALL)).code == Status.BAD_ARG
    assert host.send(Opcode.CLEAR, struct.pack("<H", Fault.ESTOP)).code == Status.OK
    assert host.move(10_000, 0).code == Status.ACCEPTED


def test_interlock(host: Host) -> None:
    host.firmware.set_interlock(True)
    assert host.move(10_000, 0).code == Status.INTERLOCK
    assert host.send(Opcode.CLEAR, struct.pack("<H", Fault.INTERLOCK)).code == Status.BAD_ARG
    host.firmware.set_interlock(False)
    assert host.send(Opcode.CLEAR, struct.pack("<H", Fault.INTERLOCK)).code == Status.OK


def test_a_stall_names_its_axis(host: Host) -> None:
    host.firmware.inject("stall")
    host.move(0, 90_000)
    host.firmware.advance(10)
    state = host.state()
    assert (state.fault, state.fault_axis) == (Fault.STALL, 1)
    assert 10_000 < host.firmware.pose[1] < 80_000


def test_release_line_counts_edges(host: Host) -> None:
    fired: list[float] = []

    def camera(seconds: float) -> None:
        fired.append(seconds)
        host.firmware.sync()

    host.firmware.release = camera
    host.send(Opcode.EXPOSE, Expose((40_000, 250), gap_ms=100).pack())
    host.firmware.advance(1)
    assert fired == [0.04, 0.00025]
    assert (host.state().batch, host.state().exposures) == (2, 2)
    host.firmware.release = None
    host.send(Opcode.EXPOSE, Expose((40_000,)).pack())
    host.firmware.advance(1)
    assert host.state().fault == Fault.XSYNC_MISSING


def test_lamp_warms_up_and_its_light_is_measured(host: Host) -> None:
    host.send(Opcode.LAMP, b"\1")
    host.firmware.advance(WARM_UP_S - 1)
    assert not host.state().has(Flag.LAMP_WARM)
    host.firmware.advance(1)
    assert host.state().has(Flag.LAMP_WARM)
    host.send(Opcode.INTENSITY, struct.pack("<H", 100))
    host.firmware.advance(0.1)
    assert host.state().photodiode == pytest.approx(100_000 * host.firmware.lamp_output, rel=1e-4)


def test_a_warm_lamp_stays_within_the_band_of_a_session() -> None:
    outputs = [lamp_output(WARM_UP_S + 10 * i) for i in range(3 * 360)]
    assert max(outputs) / min(outputs) - 1 < 0.02
    assert max(outputs) / min(outputs) - 1 > 0.005


def test_events_are_fast_while_something_moves(host: Host) -> None:
    def events(seconds: float) -> int:
        host.firmware.outbox.clear()
        host.firmware.advance(seconds)
        return len(host.firmware.outbox)

    host.firmware.advance(1)
    assert events(3) == 3
    host.move(30_000, 0)
    assert events(2) == 20


def test_features() -> None:
    firmware = Firmware(serial="OGM-0007")
    ident = firmware.get_feature(ReportId.IDENT)
    assert ident is not None
    assert Ident.unpack(Report.unpack(ident).payload).serial == "OGM-0007"
    assert firmware.get_feature(0x55) is None
    data = firmware.get_feature(ReportId.CONFIG)
    assert data is not None
    config = Config.unpack(Report.unpack(data).payload)
    narrow = Config(config.low, (45_000, *config.high[1:]), config.speeds, config.accelerations, 1000)
    assert firmware.set_feature(Report(ReportId.CONFIG, payload=narrow.pack()).pack())
    wide = Config(config.low, (95_000, *config.high[1:]), config.speeds, config.accelerations, 1000)
    assert not firmware.set_feature(Report(ReportId.CONFIG, payload=wide.pack()).pack())
    assert not firmware.set_feature(bytes(64))
    again = firmware.get_feature(ReportId.CONFIG)
    assert again is not None
    assert Config.unpack(Report.unpack(again).payload) == narrow
