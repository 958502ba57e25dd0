"""The firmware of the simulated goniometer: reports in, reports out, on a virtual clock.

A transport hands it output and feature reports and takes the input reports in `Firmware.outbox`.
"""

import os
import struct
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Literal

from kinran.rig.machine import HOMING_S, Machine, Verdict
from kinran.rig.motion import AXES
from kinran.rig.motion import Four as Axes
from kinran.rig.protocol import (
    VALIDATE_ONLY,
    X_SYNC,
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
        self._counts_edges = bool(capabilities & X_SYNC)
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

    def _timers(self) -> list[tuple[float, Callable[[], object]]]:
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
        if data[:1] != bytes([ReportId.COMMAND]):
            return
        try:
            command = Report.unpack(data)
        except ProtocolError:
            self.outbox.append(self._reply(Report(ReportId.COMMAND), (Status.BAD_CRC, b"")))
            return
        self._fed = self._now
        seq, bytes_, stored = self._last
        if command.seq in (0, seq) and command.opcode != Opcode.HELLO:
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
        """Handle a CONFIG feature; return whether it was accepted: the machine is not stretched, nor while it works."""
        try:
            report = Report.unpack(data)
            config = Config.unpack(report.payload)
        except ProtocolError:
            return False
        if report.id != ReportId.CONFIG or self._job_state is JobState.RUNNING or not config.within(self._factory):
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
            verdict = self._check(command)
        except (ProtocolError, struct.error):
            verdict = Status.BAD_ARG
        if not isinstance(verdict, Status):
            verdict = Status.OK if command.code & VALIDATE_ONLY else verdict()
        return verdict, self.state().pack()

    def _check(self, command: Report) -> Verdict:
        """Return what is wrong with a command, or what is to be done."""
        payload = command.payload
        match command.opcode:
            case Opcode.NOP | Opcode.HELLO:
                return Status.OK
            case Opcode.STOP:
                return self._stop
            case Opcode.CLEAR:
                (seen,) = struct.unpack("<H", payload)
                return partial(self._clear, seen) if self._names_fault(seen) else Status.BAD_ARG
            case Opcode.WATCHDOG:
                return partial(self._watch, struct.unpack("<I", payload)[0] / 1000)
            case Opcode.SHUTTER if payload[:1] == b"\0":
                return self._close
        if self._interlock:
            return Status.INTERLOCK
        if self._fault:
            return Status.FAULTED
        if self._job_state is JobState.RUNNING:
            return Status.BUSY
        match command.opcode:
            case Opcode.HOME:
                return self._home(*struct.unpack("<B", payload))
            case Opcode.MOVE:
                return self._move(Move.unpack(payload))
            case Opcode.LAMP:
                return partial(self._set_lamp, *struct.unpack("<B", payload))
            case Opcode.SHUTTER:
                longest_ms = struct.unpack("<BI", payload)[1]
                return partial(self._open, longest_ms / 1000) if longest_ms else Status.BAD_ARG
            case Opcode.INTENSITY:
                seconds = struct.unpack("<H", payload)[0] / 1000
                return partial(self._run, Opcode.INTENSITY, self._start, seconds)
            case Opcode.EXPOSE:
                return partial(self._expose, Expose.unpack(payload))
        return Status.UNSUPPORTED
