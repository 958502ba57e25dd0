"""The host's driver of the goniometer, real or simulated."""

import os
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

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
from kinran.rig.motion import AXES, ON_TARGET_MDEG, SETTLE_S, move_time
from kinran.rig.protocol import (
    REPORT,
    Config,
    Expose,
    Fault,
    Flag,
    Four,
    Ident,
    JobState,
    Move,
    Opcode,
    ProtocolError,
    Report,
    ReportId,
    State,
    Status,
    estop_report,
)
from kinran.rig.transport import Handle

TRIES = 3
"""Times that a command is sent with the same seq (docs/rig.md, Rules)."""
REPLY_S = 0.15
"""Seconds that a reply may take: 150 of the bus's intervals of 1 ms (docs/rig.md, Rules)."""
READ_MS = 20
"""Time-out of a read: short, so that the lock is soon free for the heartbeat, and never 0, which would block for
ever."""
HEARTBEAT_S = 0.25
"""Seconds between commands that feed the watchdog: seven may be lost before it trips (docs/rig.md, Rules)."""
WATCHDOG_MS = 2000
"""Milliseconds of silence of the host after which the rig stops and closes its shutter (docs/rig.md, Rules)."""
SLACK = 1.2
"""Factor on a job's predicted time after which, and after a second more, the host asks for its state: a choice."""

HOMING_S = 60.0
"""Seconds that homing may take: the slowest axis crosses its range in 24 s at its top speed."""
ALL_AXES = 0b1111
"""Mask of all axes."""
LIGHT_AXES = 0b0011
"""Mask of the axes of the light arm."""


class Goniometer:
    """A rig behind a HID handle.

    All calls on the handle are serialised by one lock, because hidapi forbids anything else.

    Parameters
    ----------
    handle
        An open handle, closed by `close`.
    clock
        Monotonic seconds; the virtual clock of a simulated rig.
    live
        Whether real time passes while the host is busy, so that a heartbeat thread is needed.

    Attributes
    ----------
    state
        Last state that the rig reported.
    boot
        Boot id of the firmware that `hello` found.
    retries
        Commands that were sent again.
    """

    def __init__(self, handle: Handle, clock: Callable[[], float] = time.monotonic, live: bool = True) -> None:
        self.state = State()
        self.boot = 0
        self.retries = 0
        self.config: Config | None = None
        self.ident: Ident | None = None
        self._handle = handle
        self._clock = clock
        self._live = live
        self._lock = threading.RLock()
        self._seq = 0
        self._told = clock()

    def hello(self) -> State:
        """Greet the rig: drop stale reports, read its boot id, identity and limits, set its watchdog.

        A job that a dead host left running is stopped, and the watchdog's fault is cleared; other faults stay.

        Raises
        ------
        RigError
            The rig does not answer, or speaks another protocol.
        """
        self._drain()
        self.boot = 0
        reply = self._command(Opcode.HELLO, os.urandom(4))
        self.boot = reply.boot
        self.ident = Ident.unpack(self._feature(ReportId.IDENT).payload)
        if self.ident.major != 1:
            raise RigError(f"the rig speaks protocol {self.ident.major}, not 1; update Kinran or its firmware")
        self.config = Config.unpack(self._feature(ReportId.CONFIG).payload)
        if self.state.job_state == JobState.RUNNING:
            self.stop()
        self.shutter(False)
        if self.state.fault == Fault.WATCHDOG:
            self.clear()
        self._command(Opcode.WATCHDOG, struct.pack("<I", WATCHDOG_MS))
        return self.state

    def close(self) -> None:
        """Close the shutter and the handle; the lamp stays lit, because a hot restrike ages it."""
        try:
            if self.boot:
                self.shutter(False)
        except RigError:
            pass  # gone or faulted: the watchdog closes it
        finally:
            self._handle.close()

    def status(self) -> State:
        """Read the state over the control pipe, which works when the interrupt pipe is stuck."""
        self._learn(self._feature(ReportId.STATUS))
        return self.state

    def ping(self) -> State:
        """Feed the watchdog."""
        self._command(Opcode.NOP)
        return self.state

    @contextmanager
    def heartbeat(self) -> Iterator[None]:
        """Feed the watchdog from a thread while the host is busy with the camera."""
        if not self._live:
            yield
            return
        done = threading.Event()

        def beat() -> None:
            while not done.wait(HEARTBEAT_S):
                try:
                    self.ping()
                except RigError:
                    return  # the next command of the host meets the same error

        thread = threading.Thread(target=beat, name="rig heartbeat", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join()

    def home(self) -> State:
        """Find the reference of every axis."""
        return self._job(Opcode.HOME, bytes([ALL_AXES]), HOMING_S)

    def check(self, theta_mdeg: int, phi_mdeg: int) -> None:
        """Check a pose of the light arm against the limits of the rig.

        Raises
        ------
        LimitError
            The pose is outside.
        """
        for i, value in enumerate((theta_mdeg, phi_mdeg)):
            low, high = (self.config.low[i], self.config.high[i]) if self.config else (AXES[i].low, AXES[i].high)
            if not low <= value <= high:
                raise LimitError(
                    f"{AXES[i].name} = {value / 1000:g}° is outside the rig's {low / 1000:g}° to"
                    f" {high / 1000:g}°; plan other directions"
                )

    def move(self, theta_mdeg: int, phi_mdeg: int) -> State:
        """Move the light arm; `State.position` of the result is the pose that the encoders measured.

        Raises
        ------
        LimitError
            The target is outside the limits; nothing was sent.
        OffTargetError
            The arm came to rest more than 20 mdeg off its target, twice.
        RigError
            The move failed for another reason.
        """
        self.check(theta_mdeg, phi_mdeg)
        targets: Four = (theta_mdeg, phi_mdeg, 0, 0)
        move = Move(LIGHT_AXES, targets, settle_ms=round(SETTLE_S * 1000))
        for _ in range(2):
            seconds = move_time(self.state.position[:2], targets[:2]) + SETTLE_S
            state = self._job(Opcode.MOVE, move.pack(), seconds)
            if max(abs(state.position[i] - targets[i]) for i in range(2)) <= ON_TARGET_MDEG:
                return state
        raise OffTargetError(
            f"the light arm stands at {state.position[:2]} instead of {targets[:2]} millidegrees;"
            " home the rig and look for what blocks it"
        )

    def check_fault(self) -> None:
        """Raise the fault that the rig last reported.

        Raises
        ------
        FaultError
            The rig has a fault.
        """
        if self.state.fault:
            raise FaultError(self.state.fault, self.state.fault_axis)

    def stop(self) -> State:
        """Stop all motion."""
        self._command(Opcode.STOP)
        return self.state

    def estop(self) -> None:
        """Emergency stop; the rig latches a fault."""
        with self._lock:
            self._write(estop_report())

    def clear(self) -> State:
        """Clear the fault that the rig last reported."""
        self._command(Opcode.CLEAR, struct.pack("<H", self.state.fault), faulted=True)
        return self.state

    def lamp(self, on: bool) -> State:
        """Light the lamp or put it out."""
        self._command(Opcode.LAMP, bytes([on]))
        return self.state

    def wait_warm(self, limit_s: float = 3600) -> State:
        """Wait until the lamp is warm.

        Raises
        ------
        RigError
            The lamp does not become warm in time, or the rig has a fault.
        """
        until = self._clock() + limit_s
        while not self.state.has(Flag.LAMP_WARM):
            if self._clock() > until:
                raise RigError(f"the lamp is not warm after {limit_s / 60:g} minutes; check it")
            self.wait(5.0)
            self.status()
            self.check_fault()
        return self.state

    def wait(self, seconds: float) -> None:
        """Wait, and take the rig's reports meanwhile."""
        until = self._clock() + seconds
        while (left := until - self._clock()) > 0:
            self._listen(max(1, min(500, round(left * 1000))))

    def shutter(self, is_open: bool, seconds: float = 30.0) -> State:
        """Open the lamp's shutter, for at most `seconds`, or close it."""
        self._command(Opcode.SHUTTER, struct.pack("<BI", is_open, round(seconds * 1000) if is_open else 0))
        return self.state

    def confirm_shutter(self, is_open: bool) -> None:
        """Feed the watchdog, and check that the shutter stands as it should.

        Raises
        ------
        RigError
            The shutter moved by itself, or the rig has a fault.
        """
        self.ping()
        self.check_fault()
        if self.state.has(Flag.SHUTTER) != is_open:
            raise RigError("the lamp's shutter moved by itself; check it, then run the capture again")

    def intensity(self, seconds: float = 0.1) -> int:
        """Return the counts of the photodiode at the lamp, averaged over `seconds`."""
        self._job(Opcode.INTENSITY, struct.pack("<H", round(seconds * 1000)), seconds)
        return self.state.photodiode

    def release(self, exposures_s: tuple[float, ...], gap_s: float) -> State:
        """Fire the camera's release line for up to eight exposures and count their X-sync edges."""
        batch = Expose(tuple(round(1e6 * e) for e in exposures_s), round(1000 * gap_s))
        return self._job(Opcode.EXPOSE, batch.pack(), sum(exposures_s) + gap_s * len(exposures_s))

    def _job(self, opcode: Opcode, payload: bytes, seconds: float) -> State:
        """Run a job to its end, which an event reports, or the status where the event was lost."""
        job = self._command(opcode, payload).job
        overdue = self._clock() + SLACK * seconds + 1.0
        while self.state.job == job and self.state.job_state == JobState.RUNNING:
            self._listen(READ_MS)
            if self._clock() - self._told > HEARTBEAT_S:
                self.ping()
            if self._clock() > overdue and self.status().job_state == JobState.RUNNING:
                raise RigTimeoutError(f"{opcode.name} takes longer than {SLACK * seconds + 1:.1f} s; home the rig")
        self.check_fault()
        if self.state.job != job or self.state.job_state != JobState.DONE:
            raise RigError(f"{opcode.name} was stopped before its end; run the capture again")
        return self.state

    def _command(self, opcode: Opcode, payload: bytes = b"", faulted: bool = False) -> Report:
        """Send a command until its reply comes; the rig executes it once, however often it receives it."""
        with self._lock:
            self._seq = self._seq % 0xFFFF + 1
            command = Report(ReportId.COMMAND, self._seq, opcode, boot=self.boot, payload=payload).pack()
            for attempt in range(TRIES):
                self.retries += attempt > 0
                self._write(command)
                reply = self._await(self._seq, opcode)
                if reply is not None:
                    break
            else:
                raise RigTimeoutError(
                    f"the rig does not answer to {opcode.name} after {TRIES} tries; switch it off and on"
                )
        if reply.code == Status.STALE_BOOT or (self.boot and reply.boot != self.boot):
            raise RebootedError("the rig restarted; home it and let its lamp warm up")
        if reply.code == Status.FAULTED and not faulted:
            self.check_fault()
        if reply.code not in (Status.OK, Status.ACCEPTED):
            raise RefusedError(opcode, reply.code)
        return reply

    def _await(self, seq: int, opcode: Opcode) -> Report | None:
        """Wait for the reply to a command; stale and damaged reports are ignored."""
        until = self._clock() + REPLY_S
        while self._clock() < until:
            report = self._listen(READ_MS)
            if report is None or report.id != ReportId.REPLY:
                continue
            if report.seq == seq and report.opcode == opcode:
                return report
            if report.code == Status.BAD_CRC:
                return None
        return None

    def _listen(self, timeout_ms: int) -> Report | None:
        """Return the next report, or None where none came or it was damaged."""
        with self._lock:
            try:
                data = bytes(self._handle.read(REPORT, timeout_ms))
            except OSError:  # unplugged, or a signal came: the control pipe tells which
                self._feature(ReportId.STATUS)
                return None
        try:
            report = Report.unpack(data) if data else None
        except ProtocolError:
            return None
        if report is not None:
            self._learn(report)
        return report

    def _learn(self, report: Report) -> None:
        if self.boot and report.boot != self.boot and report.id != ReportId.REPLY:
            raise RebootedError("the rig restarted; home it and let its lamp warm up")
        try:
            state = State.unpack(report.payload)
        except ProtocolError:
            return
        if report.boot != self.boot or state.uptime_ms >= self.state.uptime_ms:
            self.state = state

    def _write(self, data: bytes) -> None:
        self._told = self._clock()
        if self._handle.write(data) != len(data):
            self._feature(ReportId.STATUS)
            raise DisconnectedError("the rig takes no commands; check its cable, then run the capture again")

    def _feature(self, report: ReportId) -> Report:
        """Read a feature and check its CRC: a broken gadget answers with zeros."""
        try:
            with self._lock:
                data = bytes(self._handle.get_feature_report(report, REPORT))
        except (OSError, ValueError):
            raise DisconnectedError(
                "the rig is disconnected; check cable and power, then run the capture again"
            ) from None
        try:
            return Report.unpack(data)
        except ProtocolError as error:
            raise RigError(f"the rig's {report.name} is damaged ({error}); switch it off and on") from None

    def _drain(self) -> None:
        """Drop reports that were queued before this host connected."""
        with self._lock:
            for _ in range(100):
                try:
                    if not self._handle.read(REPORT, 1):
                        return
                except OSError:
                    self._feature(ReportId.STATUS)
