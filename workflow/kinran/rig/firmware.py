"""The firmware of the simulated goniometer: reports in, reports out, on a virtual clock.

A transport hands it output and feature reports and takes the input reports in `Firmware.outbox`.
"""

import os
import struct
from collections import deque
from collections.abc import Callable
from typing import Literal

from kinran.rig.machine import HOMING_S, Machine
from kinran.rig.motion import AXES
from kinran.rig.motion import Four as Axes
from kinran.rig.protocol import (
    VALIDATE_ONLY,
    Config,
    Expose,
    Fault,
    Ident,
    JobState,
    Move,
    Opcode,
    ProtocolError,
    Report,
    ReportId,
    Status,
)

Injection = Literal[
    "drop_command", "drop_reply", "dup_reply", "late_reply", "corrupt", "hang", "reboot", "stall",
    "off_target", "unplug",
]  # fmt: skip
Answer = tuple[Status, bytes]

LATE_S = 0.2
"""Seconds by which an injected late reply is late: more than the driver waits for one."""


class Firmware(Machine):
    """The firmware of a simulated goniometer, from power-on.

    Parameters
    ----------
    seed
        Seed of the small errors of mechanics and encoders.
    serial
        Serial number in IDENT.
    capabilities
        Bit 0: an X-sync counter.
    axes, homing_s
        Limits, speeds and accelerations, and the duration of homing in seconds.

    Attributes
    ----------
    outbox
        Input reports that the transport has not taken yet.
    plugged
        Whether the cable is in.
    boot
        Boot id, random at each start.
    """

    def __init__(
        self,
        seed: int = 0,
        serial: str = "OGM-VIRTUAL",
        capabilities: int = 1,
        axes: Axes = AXES,
        homing_s: float = HOMING_S,
    ) -> None:
        self.serial = serial
        self.capabilities = capabilities
        self.outbox: deque[bytes] = deque()
        self.plugged = True
        self._injected: deque[Injection | None] = deque()
        self._hung = False
        super().__init__(seed, axes, homing_s)
        self.reboot(cause=0)

    def reboot(self, cause: int = 2) -> None:
        """Restart: pose unknown, lamp off, another boot id."""
        self._start = self.pose
        self._reset()
        self.boot = int.from_bytes(os.urandom(4), "little") or 1
        self._reset_cause = cause
        self._last: tuple[int, bytes, bytes] = (0, b"", b"")
        self._late: deque[tuple[float, bytes]] = deque()
        self._hung = False

    def inject(self, *kinds: Injection | None) -> None:
        """Queue faults for the next commands, one each; None leaves a command alone."""
        self._injected.extend(kinds)

    def on_event(self) -> None:
        """Queue an EVENT report for the host."""
        if not self._hung:
            event = Report(ReportId.EVENT, job=self._job, boot=self.boot, payload=self.state().pack())
            self.outbox.append(event.pack())

    def _timers(self) -> list[tuple[float, Callable[[], None]]]:
        timers = super()._timers()
        if self._late:
            timers.append((self._late[0][0], self._send_late))
        return timers

    def _send_late(self) -> None:
        self.outbox.append(self._late.popleft()[1])

    # -- reports -------------------------------------------------------------------------------------

    def on_output(self, data: bytes) -> None:
        """Handle one output report."""
        if data[:1] == bytes([ReportId.ESTOP]):
            self.trip(Fault.ESTOP)
            return
        injected = self._injected.popleft() if self._injected else None
        if injected == "unplug":
            self.plugged = False
        if injected == "reboot":
            self.reboot()
        self._hung = self._hung or injected == "hang"
        if self._hung or injected in ("drop_command", "reboot", "unplug"):
            return
        self._fed = self._now
        try:
            command = Report.unpack(data)
        except ProtocolError:
            self.outbox.append(self._reply(Report(ReportId.COMMAND), (Status.BAD_CRC, b"")))
            return
        seq, bytes_, stored = self._last
        if command.seq == seq and command.opcode != Opcode.HELLO:
            self.outbox.append(stored if data == bytes_ else self._reply(command, (Status.BAD_SEQ, b"")))
            return
        reply = self._reply(command, self._execute(command))
        self._last = (command.seq, data, reply)
        self._misbehave(injected)
        self._send(reply, injected)

    def get_feature(self, report: int) -> bytes | None:
        """Return the answer to a feature request; None for no answer."""
        if self._hung:
            return None
        match report:
            case ReportId.STATUS:
                payload = self.state().pack()
            case ReportId.CONFIG:
                payload = self._config.pack()
            case ReportId.IDENT:
                payload = Ident(1, self.serial, self.capabilities, self._reset_cause).pack()
            case _:
                return None
        return Report(report, job=self._job, boot=self.boot, payload=payload).pack()

    def set_feature(self, data: bytes) -> bool:
        """Handle a CONFIG feature; return whether it was accepted."""
        try:
            report = Report.unpack(data)
            config = Config.unpack(report.payload)
        except ProtocolError:
            return False
        hard = zip(self.axes, config.low, config.high, strict=True)
        if report.id != ReportId.CONFIG or any(lo < a.low or hi > a.high for a, lo, hi in hard):
            return False
        self._config = config
        return True

    def _reply(self, command: Report, answer: Answer) -> bytes:
        status, payload = answer
        return Report(ReportId.REPLY, command.seq, command.opcode, status, self._job, self.boot, payload).pack()

    def _send(self, reply: bytes, injected: Injection | None) -> None:
        if injected == "corrupt":
            reply = reply[:20] + bytes([reply[20] ^ 1]) + reply[21:]
        if injected == "late_reply":
            self._late.append((self._now + LATE_S, reply))
        elif injected != "drop_reply":
            self.outbox.append(reply)
        if injected == "dup_reply":
            self.outbox.append(reply)

    def _misbehave(self, injected: Injection | None) -> None:
        if injected == "stall" and self._job_state is JobState.RUNNING:
            self._stall_at = (self._now + self._job_end) / 2
        if injected == "off_target":
            self._end = (self._end[0] + 50.0, *self._end[1:])

    # -- commands ------------------------------------------------------------------------------------

    def _execute(self, command: Report) -> Answer:
        if command.opcode not in (Opcode.NOP, Opcode.HELLO) and command.boot != self.boot:
            return Status.STALE_BOOT, self.state().pack()
        try:
            status = self._command(command)
        except (ProtocolError, struct.error):
            status = Status.BAD_ARG
        return status, self.state().pack()

    def _command(self, command: Report) -> Status:
        payload = command.payload
        match command.opcode:
            case Opcode.NOP | Opcode.HELLO:
                return Status.OK
            case Opcode.STOP:
                self._halt(JobState.STOPPED)
                return Status.OK
            case Opcode.CLEAR:
                return self._clear(*struct.unpack("<H", payload))
            case Opcode.WATCHDOG:
                self._watchdog_s = struct.unpack("<I", payload)[0] / 1000
                return Status.OK
            case Opcode.SHUTTER if payload[:1] == b"\0":
                self._close()
                return Status.OK
        if self._interlock:
            return Status.INTERLOCK
        if self._fault:
            return Status.FAULTED
        if self._job_state is JobState.RUNNING:
            return Status.BUSY
        validate = bool(command.code & VALIDATE_ONLY)
        match command.opcode:
            case Opcode.HOME:
                return self._home(*struct.unpack("<B", payload))
            case Opcode.MOVE:
                return self._move(Move.unpack(payload), validate)
            case Opcode.LAMP:
                return self._set_lamp(*struct.unpack("<B", payload))
            case Opcode.SHUTTER:
                return self._open(struct.unpack("<BI", payload)[1] / 1000)
            case Opcode.INTENSITY:
                seconds = struct.unpack("<H", payload)[0] / 1000
                return self._run(Opcode.INTENSITY, self._start, seconds)
            case Opcode.EXPOSE:
                return self._expose(Expose.unpack(payload))
        return Status.UNSUPPORTED
