"""A bridge to a stage of another make: two rotation axes behind a serial controller that runs GRBL 1.1.

The stage turns a light arm, X in θ and Y in φ, with degrees where GRBL says millimetres. It has no lamp, shutter,
photodiode or camera arm of its own. docs/bridges.md says how a bridge comes into a capture.
"""

import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from random import SystemRandom
from typing import Protocol

from kinran.rig.errors import DisconnectedError, LimitError, OffTargetError, RebootedError, RigError, RigTimeoutError
from kinran.rig.goniometer import ALL_AXES, Goniometer, Identity, check_fault, check_pose
from kinran.rig.motion import AXES, ON_TARGET_MDEG, SETTLE_S, Four, move_time
from kinran.rig.protocol import Fault, Flag, State

BAUD = 115_200
"""Bits a second of GRBL 1.1's serial line."""
POLL_S = 0.05
"""Seconds between two looks at a stage that moves: GRBL asks for at most five to ten a second more."""
ANSWER_S = 2.0
"""Longest time of an answer in seconds: a choice; GRBL answers in milliseconds, except to G-code in a full planner."""
HOMING_S = 120.0
"""Longest time of homing in seconds: a choice, since GRBL does not say."""
SLACK = 1.2
"""Factor on a move's predicted time after which, and after a second more, it is late: as for rigs on USB."""
ALARMS = {1: Fault.LIMIT_SWITCH, 2: Fault.LIMIT_SWITCH, 3: Fault.ESTOP}
"""Faults for GRBL's alarms: hard limit, soft limit, reset in motion; those of homing are stalls."""
GONE = "the stage is disconnected; check its cable, then run the capture again"
MOVING = ("Run", "Jog", "Home")
"""States in which GRBL moves."""
LIGHT_AXES = 0b0011
"""Mask of the axes of the light arm."""
BANNER = b"Grbl "
"""Begin of what GRBL says when it starts."""
STATUS = re.compile(rb"<(\w+)[^|>]*\|MPos:(-?[\d.]+),(-?[\d.]+),")


class Port(Protocol):
    """As much of pyserial's `Serial` as a bridge needs, opened with a time-out."""

    def readline(self) -> bytes:
        """Return a line with its end, or what came of it before the time-out."""

    def write(self, data: bytes, /) -> object:
        """Send bytes."""

    def close(self) -> None:
        """Close the port."""


@dataclass(frozen=True)
class Report:
    """What GRBL says in answer to ``?``: its state, and the position in millidegrees."""

    state: str
    position: tuple[int, int]


def open_port(path: str) -> Port:
    """Open a serial port such as ``/dev/ttyUSB0``; needs the package pyserial."""
    import serial

    port: Port = serial.Serial(path, BAUD, timeout=POLL_S)
    return port


class GrblGoniometer:
    """A stage behind GRBL (`kinran.rig.goniometer.Goniometer`).

    GRBL forgets its pose when it is switched off, and does not say whether it was. A number that it forgets, too, tells
    it: the feed rate of G1, which the bridge does not use. `hello` finds the number that an earlier `home` left.

    Parameters
    ----------
    port
        The serial port.
    serial
        Serial number of the stage, for the journal of a capture.
    axes
        Limits of the axes; top speeds and accelerations of the light arm are GRBL's own.
    clock, sleep
        Monotonic seconds, and a function that waits some.
    """

    def __init__(
        self,
        port: Port,
        serial: str = "GRBL",
        axes: Four = AXES,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.state = State()
        self.identity = Identity(serial, axes, HOMING_S, photodiode=False)
        self._port = port
        self._clock, self._sleep = clock, sleep
        self._homed = self._lit = self._open = False
        self._fault = Fault.NONE
        self._partial = b""
        self._met = False

    def hello(self) -> State:
        """Meet the stage: end what a dead host left running, read its speeds, and whether it knows its pose."""
        self._write(b"\r\n")  # ends half a line of a dead host
        self._met = False
        while self._line() is not None:
            pass  # answers to it, and the banner of a controller that starts when its port is opened
        self._met = True
        mark = re.search(r" F(\d+)", "\n".join(self._command("$G")))
        number = int(mark[1]) if mark else 0
        state = self._report().state
        self._homed = number > 0 and state != "Alarm"
        self.identity = replace(self.identity, boot=number if self._homed else _mark())
        if state in MOVING:
            self.stop()
        settings = dict(re.findall(r"\$(\d+)=([\d.]+)", "\n".join(self._command("$$"))))
        theta, phi, *camera = self.identity.axes
        try:
            theta, phi = (
                replace(
                    axis,
                    speed=round(1000 / 60 * float(settings[top])),
                    acceleration=round(1000 * float(settings[ramp])),
                )
                for axis, top, ramp in ((theta, "110", "120"), (phi, "111", "121"))
            )
        except KeyError as error:
            raise RigError(f"the stage does not state its setting ${error.args[0]}; it must run GRBL 1.1") from None
        self.identity = replace(self.identity, axes=(theta, phi, camera[0], camera[1]))
        return self.shutter(False)

    def status(self) -> State:
        """Read the state, and change nothing; a stage in alarm that told none to this host is one that is not homed."""
        report = self._report()
        self._homed = self._homed and report.state != "Alarm"
        if report.state == "Door":
            self._fault = Fault.INTERLOCK
        flags = (ALL_AXES if self._homed else 0) << Flag.HOMED
        flags |= (LIGHT_AXES if report.state in MOVING else 0) << Flag.MOVING
        flags |= self._open << Flag.SHUTTER | self._lit << Flag.LAMP | self._lit << Flag.LAMP_WARM
        flags |= (self._fault != Fault.NONE) << Flag.FAULT
        theta, phi = report.position if self._homed else (0, 0)
        uptime = int(1000 * self._clock()) & 0xFFFFFFFF
        self.state = State(uptime, (theta, phi, 0, 0), flags, self._fault)
        return self.state

    def home(self) -> State:
        """Find the reference of both axes, which ends an alarm."""
        if self._fault:
            self._reset()
        self._fault = Fault.NONE
        self._homed = False
        self._command("$H", self.identity.homing_s)
        self._command(f"F{self.identity.boot}")
        self._homed = True
        return self.status()

    def move(self, theta_mdeg: int, phi_mdeg: int, camera_mdeg: tuple[int, int] | None = None) -> State:
        """Move the light arm.

        Raises
        ------
        LimitError
            The target is outside the limits, or is one of a camera arm; nothing was sent.
        OffTargetError
            An axis came to rest more than 20 mdeg off its target, twice.
        RigError
            The move failed for another reason.
        """
        if camera_mdeg not in (None, (0, 0)):
            raise LimitError("this stage has no camera arm; plan without side views")
        check_pose(self.identity, (theta_mdeg, phi_mdeg))
        check_fault(self.status())
        if not self._homed:
            raise RigError("the stage is not homed; run `kinran rig home`")
        target = (theta_mdeg, phi_mdeg)
        for _ in range(2):
            seconds = move_time(self.state.position, target, self.identity.axes)
            self._command(f"G21 G90 G53 G0 X{theta_mdeg / 1000:.3f} Y{phi_mdeg / 1000:.3f}")
            self._until_at_rest(SLACK * seconds + 1.0)
            self._sleep(SETTLE_S)
            state = self.status()
            if all(abs(at - to) <= ON_TARGET_MDEG for at, to in zip(state.position, target, strict=False)):
                return state
        raise OffTargetError(
            f"the arm stands at {self.state.position[:2]} instead of {target} millidegrees;"
            " home the stage and look for what blocks it"
        )

    def stop(self) -> State:
        """Stop with a ramp, so that no step is lost, and forget the rest of the way."""
        self._write(b"!")
        self._until_at_rest(ANSWER_S)
        self._reset()
        if self._homed:
            self._command(f"F{self.identity.boot}")
        return self.status()

    def lamp(self, on: bool) -> State:
        """Take note of a lamp that a person switches: it counts as warm at once."""
        self._lit = on
        return self.status()

    def shutter(self, is_open: bool, seconds: float = 30.0) -> State:
        """Take note of what is asked of a shutter that is not there."""
        self._open = is_open
        return self.status()

    def intensity(self, seconds: float = 0.1) -> int:
        """Return 0: there is no photodiode, as `identity` says."""
        return 0

    def wait(self, seconds: float) -> None:
        """Let time pass; look at the stage twice a second."""
        until = self._clock() + seconds
        while (left := until - self._clock()) > 0:
            self._sleep(min(left, 0.5))
            self.status()

    def close(self) -> None:
        """Stop motion and close the port."""
        try:
            if self._met and self._report().state in MOVING:
                self.stop()
        except RigError:
            pass  # gone, or stopped by its own alarm
        finally:
            self._port.close()

    # -- lines -----------------------------------------------------------------------------------------

    def _until_at_rest(self, seconds: float) -> None:
        deadline = self._clock() + seconds
        while self._report().state in MOVING:
            if self._clock() > deadline:
                raise RigTimeoutError(f"the stage still moves after {seconds:.1f} s; switch it off and home it")
            self._sleep(POLL_S)

    def _reset(self) -> None:
        """Reset the controller, which says its banner; at rest it keeps its pose."""
        self._met = False
        self._write(b"\x18")
        deadline = self._clock() + ANSWER_S
        while not (self._line() or b"").startswith(BANNER):
            if self._clock() > deadline:
                raise RigTimeoutError("the stage does not answer to a reset; switch it off and on")
        self._met = True

    def _report(self) -> Report:
        """Ask for the real-time report, which comes between other answers, even while the stage moves."""
        self._write(b"?")
        deadline = self._clock() + ANSWER_S
        while self._clock() < deadline:
            line = self._line() or b""
            if found := STATUS.match(line):
                theta, phi = (round(1000 * float(number)) for number in found.groups()[1:])
                return Report(found[1].decode(), (theta, phi))
            if line.startswith(b"<"):
                raise RigError("the stage does not report its machine position; send it $10=1 once")
        raise RigTimeoutError("the stage does not answer; check its cable and power")

    def _command(self, text: str, seconds: float = ANSWER_S) -> list[str]:
        """Send a line, and return the lines of its answer before the ``ok``."""
        self._write(text.encode() + b"\n")
        lines: list[str] = []
        deadline = self._clock() + seconds
        while self._clock() < deadline:
            line = self._line() or b""
            if line == b"ok":
                return lines
            if line.startswith(b"error:"):
                raise RigError(f"the stage refused {text} with {line.decode()}; look it up in GRBL's list of errors")
            if line and not STATUS.match(line):
                lines.append(line.decode("ascii", "replace"))
        raise RigTimeoutError(f"the stage does not answer to {text} in {seconds:g} s; switch it off and on")

    def _line(self) -> bytes | None:
        """Return the next line without its end; None where none came in time.

        Raises
        ------
        FaultError, RebootedError
            GRBL tells an alarm, or its banner: it was switched off and on.
        """
        while not self._partial.endswith(b"\n"):
            try:
                piece = self._port.readline()
            except OSError:
                raise DisconnectedError(GONE) from None
            if not piece:
                return None
            self._partial += piece
        line, self._partial = self._partial.strip(), b""
        if alarm := re.match(rb"ALARM:(\d+)", line):
            self._fault = ALARMS.get(int(alarm[1]), Fault.STALL)
            self._homed = False
            check_fault(replace(self.state, fault=self._fault))
        if line.startswith(BANNER) and self._met:
            self._homed = False
            raise RebootedError("the stage restarted; home it")
        return line

    def _write(self, data: bytes) -> None:
        try:
            self._port.write(data)
        except OSError:
            raise DisconnectedError(GONE) from None


@contextmanager
def open_grbl(path: str, serial: str) -> Iterator[Goniometer]:
    """Open the stage on a serial port, and close it at the end; nothing is sent to it before its `hello`."""
    rig = GrblGoniometer(open_port(path), serial)
    try:
        yield rig
    finally:
        rig.close()


def _mark() -> int:
    """Return a number that is not that of an earlier start."""
    return SystemRandom().randrange(1, 100_000)
