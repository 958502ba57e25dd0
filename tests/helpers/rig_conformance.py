"""The runner of `rig_scenarios`: one host, and whatever stands behind the `Device` that it drives.

`run` raises at the first thing that is not as the table says, and returns what the device did at each step. Two such
traces are compared by `differences`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from rig_scenarios import (
    ANY,
    Again,
    Configure,
    Event,
    Events,
    Expect,
    Happen,
    Identify,
    NoFeature,
    Pass,
    Raw,
    Scenario,
    Send,
    SetFeature,
    Step,
)

from kinran.rig.firmware import Firmware
from kinran.rig.protocol import (
    X_SYNC,
    Config,
    Fault,
    Ident,
    JobState,
    Opcode,
    Report,
    ReportId,
    State,
    Status,
)

FEED_S = 0.25
"""Seconds between the commands of a host that feeds the watchdog (docs/rig.md, Rules)."""
AT_REST_MDEG, STOPPED_MDEG = 20, 100
"""Millidegrees by which two devices may differ in position: at rest by mechanics and encoders, and in motion, or
stopped in it, by what the quickest axis travels in 3 ms."""
UPTIME_MS, EVENT_NUMBERS = 5, 2
"""By how much two devices may differ in uptime, and in the events of one step: clocks of 1 ms and of floats."""


class Device(Protocol):
    """A rig, fresh from its maker and just switched on, whose time passes in `wait` alone."""

    def write(self, data: bytes) -> None:
        """Send an output report."""

    def read(self, replies: int) -> list[bytes]:
        """Return the input reports since the last call, once there are so many replies among them, or no more come."""

    def get_feature(self, report: int) -> bytes | None:
        """Return the 64 bytes of a feature; None where the device refuses."""

    def set_feature(self, data: bytes) -> bool:
        """Set a feature; return whether the device took it."""

    def wait(self, seconds: float) -> None:
        """Let time pass."""

    def happen(self, event: Event, axis: int) -> None:
        """Do to the device what `rig_scenarios.Event` names."""


class PythonDevice:
    """The simulated firmware of the library."""

    def __init__(self, firmware: Firmware | None = None) -> None:
        self.firmware = firmware or Firmware()
        self.firmware.release = self._expose

    def _expose(self, seconds: float) -> None:
        self.firmware.sync()

    def write(self, data: bytes) -> None:
        self.firmware.on_output(data)

    def read(self, replies: int) -> list[bytes]:
        reports = list(self.firmware.outbox)
        self.firmware.outbox.clear()
        return reports

    def get_feature(self, report: int) -> bytes | None:
        return self.firmware.get_feature(report)

    def set_feature(self, data: bytes) -> bool:
        return self.firmware.set_feature(data)

    def wait(self, seconds: float) -> None:
        self.firmware.advance(seconds)

    def happen(self, event: Event, axis: int) -> None:
        firmware = self.firmware
        match event:
            case "door_open" | "door_closed":
                firmware.set_interlock(event == "door_open")
            case "limit_switch":
                firmware.trip(Fault.LIMIT_SWITCH, axis)
            case "blocked":
                firmware.trip(Fault.STALL, axis)
            case "lamp_out":
                firmware.trip(Fault.LAMP_OUT)
            case "overheated":
                firmware.trip(Fault.OVERHEATED)
            case "x_sync_out":
                firmware.release = None
            case "x_sync_in":
                firmware.release = self._expose
            case "exposure":
                if firmware.release:
                    firmware.sync()
            case "power_cycle":
                firmware.reboot()
        firmware.advance(0)


@dataclass(frozen=True)
class Did:
    """What a device did at one step: its replies without boot id and state, and its state after the step."""

    step: Step
    replies: tuple[Report, ...]
    state: State


class _Host:
    """A host that believes nothing."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.seq = 0
        self.boot = 0
        self.last = b""
        self.stored = b""
        self.heard: list[bytes] = []

    def exchange(self, data: bytes, replies: int) -> list[bytes]:
        """Send bytes, and return the replies to them."""
        self.device.read(0)
        self.device.write(data)
        reports = self.device.read(replies)
        assert all(len(report) == 64 for report in reports)
        self.heard = [report for report in reports if report[0] == ReportId.EVENT]
        return [report for report in reports if report[0] == ReportId.REPLY]

    def feature(self, report: ReportId) -> Report:
        data = self.device.get_feature(report)
        assert data is not None, f"{report.name} is not answered"
        read = Report.unpack(data)
        assert (read.id, read.seq, read.opcode, read.code) == (report, 0, 0, 0)
        return read

    def state(self) -> State:
        report = self.feature(ReportId.STATUS)
        state = State.unpack(report.payload)
        assert report.job == state.job
        return state

    # -- steps -----------------------------------------------------------------------------------------

    def send(self, step: Send) -> list[bytes]:
        self.seq = step.seq if step.seq is not None else self.seq % 0xFFFF + 1
        boot = self.boot ^ step.stale
        data = Report(ReportId.COMMAND, self.seq, step.opcode, step.flags, boot=boot, payload=step.payload).pack()
        if step.flip is not None:
            data = data[: step.flip] + bytes([data[step.flip] ^ 1]) + data[step.flip + 1 :]
        replies = self.exchange(data, step.reply is not None)
        self.answered(replies, step.reply)
        for reply in map(Report.unpack, replies):
            damaged = reply.code == Status.BAD_CRC
            assert (reply.seq, reply.opcode) == ((0, 0) if damaged else (self.seq, step.opcode))
            assert len(reply.payload) == (0 if reply.code in (Status.BAD_CRC, Status.BAD_SEQ) else 48)
            if step.opcode == Opcode.HELLO:
                self.boot = reply.boot
            if reply.code == Status.STALE_BOOT:
                assert reply.boot != boot
            elif self.boot and not step.stale and not damaged and step.opcode != Opcode.NOP:
                assert reply.boot == self.boot
            self.last, self.stored = data, replies[0]
        return replies

    def again(self, step: Again) -> list[bytes]:
        replies = [reply for _ in range(step.times) for reply in self.exchange(self.last, 1)]
        if self.last[4] != Opcode.HELLO:
            assert replies == [self.stored] * step.times, "the reply is another"
        return []

    def raw(self, step: Raw) -> list[bytes]:
        replies = self.exchange(step.data, step.reply is not None)
        self.answered(replies, step.reply)
        return replies

    def answered(self, replies: Sequence[bytes], status: int | None) -> None:
        assert len(replies) == (status is not None), f"{len(replies)} replies came"
        if status not in (None, ANY):
            code = Status(Report.unpack(replies[0]).code)
            assert code == status, f"the reply is {code.name}, not {Status(status or 0).name}"

    def let_pass(self, step: Pass) -> None:
        left = step.seconds
        while step.fed and left > FEED_S:
            self.device.wait(FEED_S)
            self.send(Send(Opcode.NOP))
            left -= FEED_S
        self.device.wait(left)
        self.device.read(0)
        self.heard = []

    def events(self, step: Events) -> None:
        self.device.wait(step.seconds)
        events = [Report.unpack(data) for data in (*self.heard, *self.device.read(0))]
        self.heard = []
        assert {event.id for event in events} <= {ReportId.EVENT}
        assert {(event.seq, event.opcode, event.code) for event in events} <= {(0, 0, 0)}
        numbers = [State.unpack(event.payload).event for event in events]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)) if numbers else [])
        assert len(events) == step.count, f"{len(events)} events came, not {step.count}"

    def expect(self, step: Expect) -> None:
        state = self.state()
        assert step.jobs in (None, state.job), f"{state.job} jobs began"
        assert step.job_state in (None, state.job_state), f"the job is {JobState(state.job_state).name}"
        assert step.fault in (None, state.fault), f"the fault is {Fault(state.fault).name}"
        assert step.axis in (None, state.fault_axis), f"the fault is on axis {state.fault_axis}"
        assert step.homed in (None, state.homed), f"homed: {state.homed:04b}"
        assert step.moving in (None, state.moving), f"moving: {state.moving:04b}"
        assert step.batch in (None, state.batch), f"{state.batch} exposures of the batch"
        assert step.exposures in (None, state.exposures), f"{state.exposures} exposures"
        assert not [flag for flag in step.on if not state.has(flag)], f"flags: {state.flags:014b}"
        assert not [flag for flag in step.off if state.has(flag)], f"flags: {state.flags:014b}"
        pairs = zip(step.at, state.position, strict=False)
        assert all(a is None or abs(a - b) <= step.within for a, b in pairs), f"it stands at {state.position}"
        light = state.photodiode
        assert step.photodiode is None or abs(light - step.photodiode) <= 0.01 * step.photodiode, f"{light} counts"

    def identify(self, step: Identify) -> None:
        report = self.feature(ReportId.IDENT)
        ident = Ident.unpack(report.payload)
        assert (ident.major, ident.minor, ident.capabilities) == (1, 1, X_SYNC)
        assert report.boot == self.boot
        assert ident.serial
        assert ident.reset_cause == step.reset_cause

    def configure(self, step: Configure) -> None:
        config = Config.unpack(self.feature(ReportId.CONFIG).payload)
        wanted = replace(config, **step.fields)
        accepted = self.device.set_feature(Report(ReportId.CONFIG, payload=wanted.pack()).pack())
        assert accepted == step.accepted, f"{'accepted' if accepted else 'refused'}"
        assert Config.unpack(self.feature(ReportId.CONFIG).payload) == (wanted if accepted else config)

    def do(self, step: Step) -> list[bytes]:
        match step:
            case Send():
                return self.send(step)
            case Again():
                return self.again(step)
            case Raw():
                return self.raw(step)
            case Pass():
                self.let_pass(step)
            case Events():
                self.events(step)
            case Happen():
                self.device.happen(step.event, step.axis)
            case Expect():
                self.expect(step)
            case Identify():
                self.identify(step)
            case Configure():
                self.configure(step)
            case SetFeature():
                assert not self.device.set_feature(step.data)
            case NoFeature():
                assert self.device.get_feature(step.report) is None
        return []


def run(scenario: Scenario, device: Device) -> list[Did]:
    """Drive a device through a scenario; return what it did at each step.

    Raises
    ------
    AssertionError
        The device does something else than the scenario says; the message names the step.
    """
    host = _Host(device)
    trace = []
    for number, step in enumerate(scenario.steps):
        try:
            replies = [Report.unpack(reply) for reply in host.do(step)]
            trace.append(Did(step, tuple(replace(reply, boot=0, payload=b"") for reply in replies), host.state()))
        except AssertionError as error:
            raise AssertionError(f"{scenario.name}: step {number}, {step}: {error}") from None
    return trace


def differences(one: Sequence[Did], other: Sequence[Did]) -> list[str]:
    """Return in what two devices differ that went through the same steps: a line for the first step that tells them.

    Replies, flags, faults, jobs, exposures and light have to agree; position, uptime and number of events within the
    tolerances above. An arm that is blocked, or at its switch, is left out until time has passed, and so is where
    it stands then: devices notice after some travel.
    """
    assert len(one) == len(other)
    for number, (a, b) in enumerate(zip(one, other, strict=True)):
        if isinstance(a.step, Happen) and a.step.event in ("limit_switch", "blocked"):
            continue
        x, y = a.state, b.state
        moving = x.job_state in (JobState.RUNNING, JobState.STOPPED, JobState.FAULTED)
        tolerance = STOPPED_MDEG if moving or x.fault or y.fault else AT_REST_MDEG
        found = []
        if a.replies != b.replies:
            found.append(f"replies {a.replies} and {b.replies}")
        for name in ("flags", "fault", "fault_axis", "job", "job_state", "batch", "exposures"):
            if getattr(x, name) != getattr(y, name):
                found.append(f"{name} {getattr(x, name)} and {getattr(y, name)}")
        if x.fault not in (Fault.STALL, Fault.LIMIT_SWITCH) and any(
            abs(p - q) > tolerance for p, q in zip(x.position, y.position, strict=True)
        ):
            found.append(f"position {x.position} and {y.position}")
        if x.job_state == JobState.DONE and abs(x.following_error - y.following_error) > AT_REST_MDEG:
            found.append(f"following errors {x.following_error} and {y.following_error}")
        if abs(x.uptime_ms - y.uptime_ms) > UPTIME_MS:
            found.append(f"uptime {x.uptime_ms} and {y.uptime_ms} ms")
        events = [did[number].state.event - did[max(0, number - 1)].state.event for did in (one, other)]
        if x.fault != Fault.STALL and abs(events[0] - events[1]) > EVENT_NUMBERS:
            found.append(f"{events[0]} and {events[1]} more events")
        if abs(x.photodiode - y.photodiode) > 0.01 * max(x.photodiode, y.photodiode):
            found.append(f"photodiode {x.photodiode} and {y.photodiode}")
        if found:
            return [f"step {number}, {a.step}: {line}" for line in found]
    return []
