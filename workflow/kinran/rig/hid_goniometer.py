"""The host's driver of a goniometer that speaks the HID protocol, real or simulated."""

import os
import struct
import threading
import time
from collections.abc import Callable

from kinran.rig.errors import DisconnectedError, OffTargetError, RebootedError, RefusedError, RigError, RigTimeoutError
from kinran.rig.goniometer import ALL_AXES, Identity, check_fault, check_path, check_pose
from kinran.rig.motion import AXES, ON_TARGET_MDEG, SETTLE_S, Axis, Four, Pose, move_time, travel_time
from kinran.rig.protocol import (
    REPORT,
    X_SYNC,
    Config,
    Expose,
    Fault,
    Flag,
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
from kinran.rig.stopping import held_back, undisturbed
from kinran.rig.transport import Handle

TRIES = 4
"""Times that a command is sent with the same seq (docs/rig.md, Rules)."""
REPLY_S = 0.15
"""Seconds that a reply may take at first: 150 of the bus's intervals of 1 ms (docs/rig.md, Rules)."""
LONGEST_REPLY_S = 1.0
"""Longest time-out of a reply in seconds: two in a row still leave the watchdog fed."""
ROUND_TRIPS = 4.0
"""Time-out of a reply in measured round trips and their mean deviations, as TCP's (RFC 6298, 2.3: K = 4)."""
READ_MS = 20
"""Time-out of a read: short, so that the lock is soon free for the heartbeat, and never 0, which would block for
ever."""
HEARTBEAT_S = 0.25
"""Seconds between commands that feed the watchdog: seven may be lost before it trips (docs/rig.md, Rules)."""
WATCHDOG_MS = 2000
"""Milliseconds of silence of the host after which the rig stops and closes its shutter (docs/rig.md, Rules)."""
SLACK = 1.2
"""Factor on a job's predicted time after which, and after a second more, the host asks for its state: a choice."""

HOMING_TRAVELS, HOMING_S = 2.0, 10.0
"""Time that homing may take where the rig does not say: so many crossings of the slowest axis' range, and seconds."""
LIGHT_AXES = 0b0011
"""Mask of the axes of the light arm."""


class HidGoniometer:
    """A rig behind a HID handle (`kinran.rig.goniometer.Goniometer`).

    All calls on the handle are serialised by one lock, because hidapi forbids anything else. While the shutter is open,
    a thread feeds the rig's watchdog.

    Parameters
    ----------
    handle
        An open handle, closed by `close`.
    clock
        Monotonic seconds; the virtual clock of a simulated rig.
    live
        Whether real time passes while the host is busy, so that a heartbeat thread is needed.
    motion
        Changes the axes that the rig states, where it does not know its own speeds.
    homing_s
        Longest time of homing in seconds, where the rig does not say.

    Attributes
    ----------
    state
        Last state that the rig reported.
    identity
        What the rig said of itself at the last `hello`.
    boot
        Boot id of the firmware that `hello` found.
    retries
        Commands that were sent again.
    """

    def __init__(
        self,
        handle: Handle,
        clock: Callable[[], float] = time.monotonic,
        live: bool = True,
        motion: Callable[[Four], Four] = lambda axes: axes,
        homing_s: float | None = None,
    ) -> None:
        self.state = State()
        self.identity = Identity("")
        self.boot = 0
        self.retries = 0
        self._motion = motion
        self._homing_s = homing_s
        self._reply_s = REPLY_S
        self._trip_s, self._deviation_s = 0.0, 0.0
        self._beat: tuple[threading.Event, threading.Thread] | None = None
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
        self._identify()
        if self.state.job_state == JobState.RUNNING:
            self.stop()
        self.shutter(False)
        if self.state.fault == Fault.WATCHDOG:
            self.clear()
        self._command(Opcode.WATCHDOG, struct.pack("<I", WATCHDOG_MS))
        return self.state

    def look(self) -> State:
        """Read identity and state over the control pipe alone, which changes nothing in the rig.

        Raises
        ------
        RigError
            The rig does not answer, or speaks another protocol.
        """
        self._identify()
        return self.status()

    def close(self) -> None:
        """Stop motion, close the shutter and the handle; the lamp stays lit, because a hot restrike ages it.

        Signals wait until that is done: a second Ctrl-C must not leave the arm moving.
        """
        self._end_heartbeat()
        try:
            with undisturbed():
                if self.boot:
                    self.stop()  # also a job whose start this host did not hear of
                    self.shutter(False)
        except RigError:
            pass  # gone or faulted: the watchdog stops it and closes the shutter
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

    def home(self) -> State:
        """Find the reference of every axis."""
        return self._job(Opcode.HOME, bytes([ALL_AXES]), self.identity.homing_s)

    def move(self, theta_mdeg: int, phi_mdeg: int, camera_mdeg: tuple[int, int] | None = None) -> State:
        """Move the light arm, and the camera arm; `State.position` of the result is the pose that encoders measured.

        Raises
        ------
        LimitError
            The target is outside the limits, or the arms would meet on the way; nothing was sent.
        OffTargetError
            An arm came to rest more than 20 mdeg off its target, twice.
        RigError
            The move failed for another reason.
        """
        check_pose(self.identity, (theta_mdeg, phi_mdeg, *(camera_mdeg or ())))
        camera = camera_mdeg or (self.state.position[2], self.state.position[3])
        targets: Pose = (theta_mdeg, phi_mdeg, *camera)
        if self.state.homed == ALL_AXES:
            check_path(self.state.position, targets)
        axes = 4 if camera_mdeg else 2
        sent: Pose = (theta_mdeg, phi_mdeg, *(camera_mdeg or (0, 0)))
        move = Move(ALL_AXES if camera_mdeg else LIGHT_AXES, sent, settle_ms=round(SETTLE_S * 1000))
        for _ in range(2):
            seconds = move_time(self.state.position, targets, self.identity.axes) + SETTLE_S
            state = self._job(Opcode.MOVE, move.pack(), seconds)
            if max(abs(state.position[i] - targets[i]) for i in range(axes)) <= ON_TARGET_MDEG:
                return state
        raise OffTargetError(
            f"the arm stands at {state.position[:axes]} instead of {targets[:axes]} millidegrees;"
            " home the rig and look for what blocks it"
        )

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

    def wait(self, seconds: float) -> None:
        """Wait, and take the rig's reports meanwhile."""
        until = self._clock() + seconds
        while (left := until - self._clock()) > 0:
            self._listen(max(1, min(500, round(left * 1000))))
            if self.state.has(Flag.SHUTTER) and self._clock() - self._told > HEARTBEAT_S:
                self.ping()

    def shutter(self, is_open: bool, seconds: float = 30.0) -> State:
        """Open the lamp's shutter, for at most `seconds`, or close it."""
        self._end_heartbeat()
        self._command(Opcode.SHUTTER, struct.pack("<BI", is_open, round(seconds * 1000) if is_open else 0))
        if is_open and self._live:
            self._begin_heartbeat()
        return self.state

    def _begin_heartbeat(self) -> None:
        """Feed the watchdog from a thread while the host is busy with the camera."""
        done = threading.Event()

        def beat() -> None:
            while not done.wait(HEARTBEAT_S):
                try:
                    self.ping()
                except RigError:
                    return  # the next command of the host meets the same error

        thread = threading.Thread(target=beat, name="rig heartbeat", daemon=True)
        thread.start()
        self._beat = done, thread

    def _end_heartbeat(self) -> None:
        if self._beat:
            done, thread = self._beat
            self._beat = None
            done.set()
            thread.join()

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
        check_fault(self.state)
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
                sent = self._clock()
                self._write(command)
                reply = self._await(self._seq, opcode, min(self._reply_s * 2**attempt, LONGEST_REPLY_S))
                if reply is not None:
                    if attempt == 0:  # later ones may answer an earlier sending (RFC 6298, 3)
                        self._took(self._clock() - sent)
                    break
            else:
                raise RigTimeoutError(
                    f"the rig does not answer to {opcode.name} after {TRIES} tries; switch it off and on"
                )
        if reply.code == Status.STALE_BOOT or (self.boot and reply.boot != self.boot):
            raise RebootedError("the rig restarted; home it and let its lamp warm up")
        if reply.code == Status.FAULTED and not faulted:
            check_fault(self.state)
        if reply.code not in (Status.OK, Status.ACCEPTED):
            raise RefusedError(opcode, reply.code)
        return reply

    def _took(self, seconds: float) -> None:
        """Learn how long a reply takes, so that a loaded host or a slow bus waits longer before it repeats itself."""
        self._deviation_s += (abs(seconds - self._trip_s) - self._deviation_s) / 4
        self._trip_s += (seconds - self._trip_s) / 8
        wanted = ROUND_TRIPS * (self._trip_s + self._deviation_s)
        self._reply_s = min(max(REPLY_S, wanted), LONGEST_REPLY_S)

    def _await(self, seq: int, opcode: Opcode, seconds: float) -> Report | None:
        """Wait for the reply to a command; stale and damaged reports are ignored."""
        until = self._clock() + seconds
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
        data = self._read(timeout_ms)
        try:
            report = Report.unpack(data) if data else None
        except ProtocolError:
            return None
        if report is not None:
            self._learn(report)
        return report

    def _read(self, timeout_ms: int) -> bytes:
        """Return the bytes of the next report, or none where none came."""
        try:
            with self._lock, held_back():
                return bytes(self._handle.read(REPORT, timeout_ms))
        except OSError:  # unplugged, or the kernel was disturbed: the control pipe tells which
            self._feature(ReportId.STATUS)
            return b""

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
            with self._lock, held_back():
                data = bytes(self._handle.get_feature_report(report, REPORT))
        except (OSError, ValueError):
            raise DisconnectedError(
                "the rig is disconnected; check cable and power, then run the capture again"
            ) from None
        try:
            return Report.unpack(data)
        except ProtocolError as error:
            raise RigError(f"the rig's {report.name} is damaged ({error}); switch it off and on") from None

    def _identify(self) -> None:
        """Read IDENT and CONFIG."""
        report = self._feature(ReportId.IDENT)
        ident, config = Ident.unpack(report.payload), Config.unpack(self._feature(ReportId.CONFIG).payload)
        if ident.major != 1:
            raise RigError(f"the rig speaks protocol {ident.major}, not 1; update Kinran or its firmware")
        axes = self._motion(axes_of(config))
        slowest = max(travel_time(axis.high - axis.low, axis.speed, axis.acceleration) for axis in axes)
        homing_s = self._homing_s or config.homing_s or HOMING_TRAVELS * slowest + HOMING_S
        x_sync = bool(ident.capabilities & X_SYNC)
        self.identity = Identity(ident.serial, axes, homing_s, report.boot, x_sync)

    def _drain(self) -> None:
        """Drop reports that were queued before this host connected."""
        for _ in range(100):
            if not self._read(1):
                return


def axes_of(config: Config) -> Four:
    """Return the axes that a rig states; a speed or acceleration that it does not state is the simulated rig's."""
    a, b, c, d = (
        Axis(axis.name, low, high, 10 * speed or axis.speed, 1000 * acceleration or axis.acceleration)
        for axis, low, high, speed, acceleration in zip(
            AXES, config.low, config.high, config.speeds, config.accelerations, strict=True
        )
    )
    return a, b, c, d
