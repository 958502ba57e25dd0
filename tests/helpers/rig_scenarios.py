"""What every rig must do, as one table: `SCENARIOS` drives the simulated firmware, the firmware in C and a device in a
virtual machine alike (`rig_conformance.py` has the runner).

A scenario begins with a rig fresh from its maker, just switched on: CONFIG as delivered, pose unknown, lamp off, door
closed, X-sync cable in. It is data: what the host sends and what must come back, how much time passes, what happens to
the rig from outside.
"""

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from kinran.rig.protocol import (
    VALIDATE_ONLY,
    Expose,
    Fault,
    Flag,
    JobState,
    Move,
    Opcode,
    Report,
    ReportId,
    Status,
    estop_report,
)

Event = Literal[
    "door_open", "door_closed", "limit_switch", "blocked", "lamp_out", "overheated", "x_sync_out", "x_sync_in",
    "exposure", "power_cycle",
]  # fmt: skip
"""What happens to a rig: `limit_switch` and `blocked` on an axis; `exposure` is one by the host's own hand."""
ANY = -1
"""A reply whose status the scenario leaves open; implementations must agree on it all the same."""


@dataclass(frozen=True)
class Send:
    """The host sends a command; its reply has this status, and None is no reply.

    Attributes
    ----------
    seq
        Its seq; None is the next one.
    stale
        Whether it carries another boot id than the rig's.
    flip
        Byte whose lowest bit the line flips.
    """

    opcode: int
    payload: bytes = b""
    reply: int | None = Status.OK
    flags: int = 0
    seq: int | None = None
    stale: bool = False
    flip: int | None = None


@dataclass(frozen=True)
class Again:
    """The host sends its last command again, and gets the stored reply, byte by byte; HELLO is executed anew."""

    times: int = 1


@dataclass(frozen=True)
class Raw:
    """The host sends bytes; the reply has this status, and None is no reply."""

    data: bytes
    reply: int | None = None


@dataclass(frozen=True)
class Pass:
    """Time passes; with `fed`, the host feeds the watchdog four times a second."""

    seconds: float
    fed: bool = False


@dataclass(frozen=True)
class Events:
    """Time passes; since the step before, if that took no time, the rig has sent this many events."""

    seconds: float
    count: int


@dataclass(frozen=True)
class Happen:
    """Something happens to the rig."""

    event: Event
    axis: int = 0


@dataclass(frozen=True)
class Expect:
    """What STATUS says now; None is not looked at.

    Attributes
    ----------
    jobs
        Jobs that began since the rig was switched on, which is how often commands that begin one were executed.
    at
        Position in millidegrees, within `within`; None for an axis that is not looked at.
    photodiode
        Counts, within 1 %.
    on, off
        Flags that are set, and that are not.
    """

    jobs: int | None = None
    job_state: JobState | None = None
    fault: Fault | None = None
    axis: int | None = None
    homed: int | None = None
    moving: int | None = None
    on: tuple[Flag, ...] = ()
    off: tuple[Flag, ...] = ()
    at: tuple[float | None, ...] = ()
    within: float = 20.0
    batch: int | None = None
    exposures: int | None = None
    photodiode: float | None = None


@dataclass(frozen=True)
class Identify:
    """IDENT says protocol 1, the X-sync counter, and this cause of the last start."""

    reset_cause: int


@dataclass(frozen=True)
class Configure:
    """The host writes CONFIG with some of its fields changed; a rig that accepts it gives it back."""

    accepted: bool
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SetFeature:
    """The host writes the bytes of a feature, and the rig refuses them."""

    data: bytes


@dataclass(frozen=True)
class NoFeature:
    """The rig has no feature of this number."""

    report: int


Step = Send | Again | Raw | Pass | Events | Happen | Expect | Identify | Configure | SetFeature | NoFeature


@dataclass(frozen=True)
class Scenario:
    """One scenario: what it shows, and its steps."""

    name: str
    steps: tuple[Step, ...]

    @property
    def seconds(self) -> float:
        """Time of the rig that passes in it."""
        return sum(step.seconds for step in self.steps if isinstance(step, Pass | Events))


# -- words of the scenarios ------------------------------------------------------------------------------------------

OK, ACCEPTED = Status.OK, Status.ACCEPTED
FULL = (90_000, 370_000, 75_000, 360_000)
"""Upper limits of the simulated rig's axes in millidegrees."""
HOMING = Pass(6)
"""Homing takes 5 s on the simulated rigs."""


def move(
    *targets: int,
    mask: int = 3,
    settle_ms: int = 0,
    speeds: tuple[int, int, int, int] = (0, 0, 0, 0),
    reply: int = ACCEPTED,
    flags: int = 0,
) -> Send:
    """MOVE to targets in millidegrees; those left out are 0."""
    a, b, c, d = (*targets, 0, 0, 0, 0)[:4]
    return Send(Opcode.MOVE, Move(mask, (a, b, c, d), settle_ms, speeds).pack(), reply, flags)


def hello(seq: int | None = None) -> Send:
    return Send(Opcode.HELLO, b"\1\2\3\4", seq=seq)


def home(mask: int = 15, reply: int = ACCEPTED) -> Send:
    return Send(Opcode.HOME, bytes([mask]), reply)


def lamp(on: bool = True, reply: int = OK) -> Send:
    return Send(Opcode.LAMP, bytes([on]), reply)


def shutter(ms: int = 60_000, reply: int = OK) -> Send:
    """SHUTTER opens for at most some milliseconds; 0 closes it."""
    return Send(Opcode.SHUTTER, struct.pack("<BI", ms > 0, ms), reply)


def watchdog(ms: int) -> Send:
    return Send(Opcode.WATCHDOG, struct.pack("<I", ms))


def clear(fault: int, reply: int = OK) -> Send:
    return Send(Opcode.CLEAR, struct.pack("<H", fault), reply)


def intensity(ms: int = 100, reply: int = ACCEPTED) -> Send:
    return Send(Opcode.INTENSITY, struct.pack("<H", ms), reply)


def expose(*open_us: int, gap_ms: int = 100, reply: int = ACCEPTED) -> Send:
    return Send(Opcode.EXPOSE, Expose(open_us, gap_ms).pack(), reply)


def stop() -> Send:
    return Send(Opcode.STOP)


ESTOP = Raw(estop_report())
MET = (hello(), watchdog(0))
"""A host that has said hello and needs no watchdog."""
HOMED = (*MET, home(), HOMING, Expect(jobs=1, job_state=JobState.DONE, homed=15, at=(0, 0, 0, 0)))
LIT = (*HOMED, lamp(), shutter(), Expect(on=(Flag.LAMP, Flag.SHUTTER)))
FAR = (*HOMED, move(60_000, 0), Pass(10), move(0, 0, 30_000, mask=4), Pass(10))
"""The light arm at θ 60°, the camera arm at θ 30°, both at φ 0."""


def _of(id_: int, **fields: Any) -> bytes:
    return Report(id_, **fields).pack()


def _hello_with(offset: int, value: int) -> bytes:
    """Return a HELLO with one byte changed and the right CRC."""
    body = bytearray(_of(ReportId.COMMAND, seq=7, opcode=Opcode.HELLO)[:60])
    body[offset] = value
    return bytes(body) + struct.pack("<I", zlib.crc32(body))


def refused(fault: Fault, status: Status = Status.FAULTED) -> tuple[Step, ...]:
    """Nothing that begins something is executed while a fault is latched, and a wrong name does not clear it."""
    other = Fault.STALL if fault != Fault.STALL else Fault.ESTOP
    begins = (home(), move(10_000, 0), lamp(), shutter(), intensity(), expose(1000))
    return (
        Expect(fault=fault, on=(Flag.FAULT,), off=(Flag.SHUTTER,), moving=0),
        *(Send(step.opcode, step.payload, status) for step in begins),
        clear(other, Status.BAD_ARG),
        clear(0, Status.BAD_ARG),
        Expect(fault=fault),
    )


SCENARIOS = [
    # meeting
    Scenario("hello tells the boot id, and nothing runs yet", (
        hello(),
        Expect(jobs=0, job_state=JobState.IDLE, fault=Fault.NONE, axis=255, homed=0, moving=0, exposures=0, batch=0),
        Expect(off=(Flag.SHUTTER, Flag.LAMP, Flag.FAULT, Flag.INTERLOCK, Flag.LAMP_WARM)),
        Identify(reset_cause=0),
    )),
    Scenario("commands before hello are stale, and NOP is not", (
        Send(Opcode.LAMP, b"\1", Status.STALE_BOOT, stale=True),
        Send(Opcode.NOP, stale=True),
        Expect(off=(Flag.LAMP,)),
    )),
    Scenario("the watchdog at start is CONFIG's", (
        hello(), Expect(on=(Flag.WATCHDOG,)), shutter(), Pass(1.9), Expect(on=(Flag.SHUTTER,)),
        Pass(0.2), Expect(fault=Fault.WATCHDOG, off=(Flag.SHUTTER,)),
    )),
    Scenario("no feature but the three, and none that is not whole", (
        *MET, NoFeature(0x55), NoFeature(ReportId.COMMAND), SetFeature(bytes(64)),
        SetFeature(_of(ReportId.CONFIG, payload=bytes(7))), SetFeature(_of(ReportId.STATUS, payload=bytes(48))),
    )),
    # at most once
    Scenario("a command that comes three times is executed once", (
        *HOMED, move(10_000, 0), Again(2), Pass(5), Expect(jobs=2, at=(10_000, 0, 0, 0)), Again(),
        Pass(5), Expect(jobs=2),
    )),
    Scenario("the stored reply is that of the first time, though the state has changed", (
        *MET, lamp(), Pass(3), Again(2),
    )),
    Scenario("one seq with other bytes is refused", (
        *HOMED, Send(Opcode.LAMP, b"\1", seq=100), Send(Opcode.LAMP, b"\0", Status.BAD_SEQ, seq=100),
        Expect(on=(Flag.LAMP,)), Send(Opcode.LAMP, b"\0", seq=101), Expect(off=(Flag.LAMP,)),
    )),
    Scenario("seq 0 belongs to events", (
        *MET, Send(Opcode.LAMP, b"\1", Status.BAD_SEQ, seq=0), Expect(off=(Flag.LAMP,)),
        Send(Opcode.NOP, reply=Status.BAD_SEQ, seq=0),
    )),
    Scenario("seq goes round", (
        *MET, Send(Opcode.LAMP, b"\1", seq=65_535), Send(Opcode.LAMP, b"\0", seq=1), Expect(off=(Flag.LAMP,)),
    )),
    Scenario("hello is heard whatever its seq", (
        *MET, lamp(), hello(seq=3), hello(seq=3), hello(seq=3),
    )),
    Scenario("a new host whose seq begins again is not answered from the old one's store", (
        *HOMED, hello(seq=1), Send(Opcode.WATCHDOG, struct.pack("<I", 0), seq=2),
        Send(Opcode.HOME, b"\x0f", ACCEPTED, seq=3), HOMING, Expect(jobs=2, homed=15),
    )),
    # bad bytes
    Scenario("damaged commands are not executed", (
        *MET, Send(Opcode.LAMP, b"\1", Status.BAD_CRC, flip=12), Expect(off=(Flag.LAMP,)),
        Send(Opcode.LAMP, b"\1", Status.BAD_CRC, flip=63), Send(Opcode.LAMP, b"\1", Status.BAD_CRC, flip=2),
        Expect(off=(Flag.LAMP,)), lamp(), Expect(on=(Flag.LAMP,)),
    )),
    Scenario("another version, or a payload that is too long", (
        *MET, Raw(_hello_with(1, 2), Status.BAD_CRC), Raw(_hello_with(6, 49), Status.BAD_CRC),
        Raw(_of(ReportId.COMMAND)[:40], Status.BAD_CRC),
    )),
    Scenario("output reports of other numbers are no commands", (
        *MET, Raw(_of(ReportId.REPLY, seq=9, opcode=Opcode.HELLO)), Raw(_of(ReportId.STATUS, seq=9)),
        Raw(_of(0x77, seq=9)), Send(Opcode.NOP),
    )),
    Scenario("noise does not feed the watchdog", (
        hello(), watchdog(1000), shutter(), Pass(0.9), Send(Opcode.NOP, b"", Status.BAD_CRC, flip=20), Pass(0.2),
        Expect(fault=Fault.WATCHDOG),
    )),
    Scenario("an opcode that nobody knows", (
        *MET, Send(0x77, reply=Status.UNSUPPORTED), Send(0xFF, reply=Status.UNSUPPORTED),
    )),
    Scenario("payloads of the wrong length", (
        *HOMED,
        *(Send(op, b"\1", Status.BAD_ARG) for op in (Opcode.MOVE, Opcode.CLEAR, Opcode.INTENSITY, Opcode.EXPOSE)),
        *(Send(op, b"\1\0", Status.BAD_ARG) for op in (Opcode.HOME, Opcode.LAMP, Opcode.SHUTTER, Opcode.WATCHDOG)),
        *(Send(op, b"", Status.BAD_ARG) for op in (Opcode.HOME, Opcode.LAMP, Opcode.SHUTTER, Opcode.WATCHDOG)),
        Send(Opcode.MOVE, bytes(48), Status.BAD_ARG), Send(Opcode.SHUTTER, b"\1\xff\0\0\0\0", Status.BAD_ARG),
        Expect(jobs=1, off=(Flag.LAMP, Flag.SHUTTER)),
    )),
    Scenario("a batch of none or of nine exposures", (
        *MET, Send(Opcode.EXPOSE, bytes(36), Status.BAD_ARG),
        Send(Opcode.EXPOSE, b"\x09" + bytes(35), Status.BAD_ARG), Expect(jobs=0),
    )),
    Scenario("an axis that is not there", (
        *HOMED, home(0x1F, Status.BAD_ARG), home(0, Status.BAD_ARG),
        move(0, 0, mask=0x13, reply=Status.BAD_ARG), Expect(jobs=1, homed=15),
    )),
    # boot id
    Scenario("after a power cycle old commands are stale, and the pose is unknown", (
        *LIT, move(10_000, 0, reply=ACCEPTED), Pass(5, fed=True), Happen("power_cycle"),
        Send(Opcode.LAMP, b"\1", Status.STALE_BOOT), move(10_000, 0, reply=Status.STALE_BOOT), Send(Opcode.NOP),
        Expect(jobs=0, homed=0, at=(0, 0, 0, 0), off=(Flag.LAMP, Flag.SHUTTER), fault=Fault.NONE),
        hello(), watchdog(0), move(10_000, 0, reply=Status.NOT_HOMED), home(), HOMING, move(10_000, 0), Pass(5),
        Expect(jobs=2, at=(10_000, 0, 0, 0)), Identify(reset_cause=2),
    )),
    Scenario("a power cycle in the middle of a move", (
        *HOMED, move(80_000, 0), Pass(2), Happen("power_cycle"), Expect(job_state=JobState.IDLE, moving=0, homed=0),
    )),
    Scenario("a stale command does not stop", (
        *HOMED, move(80_000, 0), Pass(2), Send(Opcode.STOP, b"", Status.STALE_BOOT, stale=True),
        Expect(job_state=JobState.RUNNING), Pass(10), Expect(at=(80_000, 0, 0, 0)),
    )),
    # homing
    Scenario("no move before homing", (
        *MET, move(10_000, 0, reply=Status.NOT_HOMED), Expect(jobs=0), home(), Expect(moving=15, homed=0), HOMING,
        move(10_000, 0), Pass(5), Expect(at=(10_000, 0, 0, 0)),
    )),
    Scenario("no move before all axes are homed, for nobody knows where the others stand", (
        *MET, home(3), HOMING, Expect(homed=3), move(10_000, 0, reply=Status.NOT_HOMED), home(12), HOMING,
        Expect(homed=15), move(10_000, 0), Pass(5),
    )),
    Scenario("homing that is stopped leaves its axes without a pose", (
        *HOMED, home(1), Pass(1), stop(), Expect(jobs=2, job_state=JobState.STOPPED, homed=14),
        move(10_000, 0, reply=Status.NOT_HOMED), home(1), HOMING, Expect(homed=15),
    )),
    Scenario("homing that finds no reference is a stall", (
        *MET, home(), Pass(1), Happen("blocked", 2), Pass(8), Expect(axis=2, job_state=JobState.FAULTED, homed=0),
        *refused(Fault.STALL), clear(Fault.STALL), home(), HOMING, Expect(homed=15),
    )),
    # moving
    Scenario("a move ends at its target", (
        *HOMED, move(35_000, 120_000), Expect(jobs=2, job_state=JobState.RUNNING, moving=3), Pass(10),
        Expect(job_state=JobState.DONE, moving=0, at=(35_000, 120_000, 0, 0)),
        move(0, 0, 0, 90_000, mask=8), Expect(moving=8), Pass(10), Expect(at=(35_000, 120_000, 0, 90_000)),
    )),
    Scenario("all axes arrive at once, on a trapezoid", (
        *HOMED, move(10_000, 10_000), Pass(0.5), Expect(at=(2_500, 2_500, 0, 0), moving=3, within=40),
        Pass(0.5), Expect(at=(7_500, 7_500, 0, 0), within=40), Pass(0.4), Expect(job_state=JobState.RUNNING),
        Pass(0.2), Expect(job_state=JobState.DONE, at=(10_000, 10_000, 0, 0)),
    )),
    Scenario("a short move is over before it is at top speed", (
        *HOMED, move(2_000, 0), Pass(0.2), Expect(at=(400, 0, 0, 0)), Pass(0.2), Expect(at=(1_462, 0, 0, 0)), Pass(0.2),
        Expect(job_state=JobState.RUNNING), Pass(0.1), Expect(job_state=JobState.DONE),
    )),
    Scenario("the slowest axis sets the pace", (
        *HOMED, move(20_000, 120_000), Pass(2), Expect(at=(8_750, 52_500, 0, 0), within=60), Pass(2.4),
        Expect(job_state=JobState.RUNNING), Pass(0.2), Expect(job_state=JobState.DONE),
    )),
    Scenario("a move has its own speeds, and top speed is the most", (
        *HOMED, move(10_000, 0, speeds=(2_000, 0, 0, 0)), Pass(3), Expect(at=(5_900, 0, 0, 0), within=40), Pass(2),
        Expect(job_state=JobState.RUNNING), Pass(0.2), Expect(job_state=JobState.DONE),
        move(60_000, 0, speeds=(90_000_000, 0, 0, 0)), Pass(5.4), Expect(job_state=JobState.RUNNING), Pass(0.2),
        Expect(job_state=JobState.DONE),
    )),
    Scenario("the rest at the end of a move is part of the job", (
        *HOMED, move(5_000, 0, settle_ms=500), Pass(1.3), Expect(job_state=JobState.RUNNING, at=(5_000, 0, 0, 0)),
        Pass(0.3), Expect(job_state=JobState.DONE),
    )),
    Scenario("a move to where the arm stands is a job, too", (
        *HOMED, move(10_000, 0), Pass(5), move(10_000, 0), Pass(0.1),
        Expect(jobs=3, job_state=JobState.DONE, at=(10_000, 0, 0, 0)),
    )),
    Scenario("soft limits", (
        *HOMED, *(
            move(*target, mask=mask, reply=Status.LIMIT)
            for target, mask in [
                ((-1, 0), 3), ((90_001, 0), 3), ((0, 370_001), 3), ((0, -10_001), 3), ((0, 0, 75_001), 4),
                ((0, 0, 0, -360_001), 8), ((0, 2**31 - 1), 2),
            ]
        ),
        move(90_000, 370_000), Pass(20), Expect(jobs=2, at=(90_000, 370_000, 0, 0)),
    )),
    Scenario("targets of axes that are not moved do not matter", (
        *HOMED, move(10_000, 999_999, 999_999, 999_999, mask=1), Pass(5), Expect(jobs=2, at=(10_000, 0, 0, 0)),
    )),
    Scenario("one job at a time", (
        *HOMED, move(80_000, 0), move(10_000, 0, reply=Status.BUSY), home(reply=Status.BUSY), lamp(reply=Status.BUSY),
        shutter(reply=Status.BUSY), intensity(reply=Status.BUSY), expose(1000, reply=Status.BUSY),
        Send(0x77, reply=Status.BUSY), shutter(0), Pass(20), Expect(jobs=2, at=(80_000, 0, 0, 0)),
    )),
    Scenario("STOP ends a job where it is", (
        *HOMED, move(80_000, 0), Pass(2), stop(),
        Expect(job_state=JobState.STOPPED, moving=0, fault=Fault.NONE, at=(17_500, 0, 0, 0), within=60),
        Pass(3), Expect(at=(17_500, 0, 0, 0), within=60), move(10_000, 0), Pass(5),
        Expect(jobs=3, job_state=JobState.DONE, at=(10_000, 0, 0, 0)),
    )),
    Scenario("STOP where nothing runs", (*HOMED, stop(), Expect(job_state=JobState.DONE), stop())),
    Scenario("CLEAR of no fault leaves a running job alone", (
        *HOMED, move(80_000, 0), Pass(1), clear(0), Expect(job_state=JobState.RUNNING, moving=1), Pass(10),
        Expect(job_state=JobState.DONE, at=(80_000, 0, 0, 0)),
    )),
    Scenario("job numbers go round and leave 0 out", (
        *MET, *(step for _ in range(256) for step in (intensity(0), Pass(0.01))), Expect(jobs=1),
    )),
    # arms
    Scenario("the arms do not meet at the end of a move, nor on the way", (
        *FAR, move(35_000, 0, reply=Status.COLLISION), move(10_000, 0, reply=Status.COLLISION), Expect(jobs=3),
        move(40_000, 0), Pass(10), Expect(at=(40_000, 0, 30_000, 0)),
    )),
    Scenario("the angle between the arms is that of the great circle", (
        *FAR, move(60_000, 90_000), Pass(10), move(30_000, 20_000), Pass(10), Expect(at=(30_000, 20_000, 30_000, 0)),
        move(30_000, 14_000, reply=Status.COLLISION), move(30_000, 17_000), Pass(5),
    )),
    Scenario("the camera arm does not run into the light arm", (
        *HOMED, move(30_000, 0), Pass(5), move(0, 0, 60_000, mask=4, reply=Status.COLLISION),
        move(0, 0, -30_000, mask=4), Pass(10), Expect(at=(30_000, 0, -30_000, 0)),
        move(0, 0, 0, 180_000, mask=8, reply=Status.COLLISION),
    )),
    Scenario("a camera arm on N is out of reach", (
        *HOMED, move(0, 0, 900, mask=4), Pass(3), move(20_000, 0), Pass(5), move(0, 0), Pass(5),
        Expect(jobs=4, at=(0, 0, 900, 0)),
    )),
    Scenario("a move of both arms is looked at as they go together", (
        *HOMED, move(60_000, 0), Pass(10), move(30_000, 0, 30_000, mask=7, reply=Status.COLLISION),
        move(80_000, 0, 50_000, mask=5), Pass(10), Expect(at=(80_000, 0, 50_000, 0)),
    )),
    # validate only
    Scenario("what is only validated is not done", (
        *HOMED,
        move(10_000, 0, flags=VALIDATE_ONLY, reply=OK), move(99_000, 0, flags=VALIDATE_ONLY, reply=Status.LIMIT),
        *(
            Send(step.opcode, step.payload, OK, VALIDATE_ONLY)
            for step in (home(), lamp(), shutter(), intensity(), expose(1000), watchdog(500), stop())
        ),
        Pass(3), Expect(jobs=1, homed=15, at=(0, 0, 0, 0), off=(Flag.LAMP, Flag.SHUTTER, Flag.WATCHDOG)),
        shutter(), Send(Opcode.SHUTTER, bytes(5), OK, VALIDATE_ONLY), move(80_000, 0), Pass(1),
        Send(Opcode.STOP, b"", OK, VALIDATE_ONLY), Expect(on=(Flag.SHUTTER,), job_state=JobState.RUNNING),
        ESTOP, Send(Opcode.CLEAR, b"\1\0", OK, VALIDATE_ONLY), Expect(fault=Fault.ESTOP),
        Send(Opcode.CLEAR, b"\3\0", Status.BAD_ARG, VALIDATE_ONLY),
    )),
    # lamp and shutter
    Scenario("the lamp", (*MET, lamp(), Expect(on=(Flag.LAMP,)), lamp(), lamp(False), Expect(off=(Flag.LAMP,)))),
    Scenario("the lamp is warm after half an hour, and its light is measured", (
        *MET, intensity(), Pass(0.2), Expect(photodiode=0), lamp(), intensity(), Pass(0.2),
        Expect(photodiode=85_000), Pass(1000), lamp(), Pass(799.7), Expect(off=(Flag.LAMP_WARM,)), Pass(0.2),
        Expect(on=(Flag.LAMP_WARM,)), intensity(), Pass(0.2), Expect(photodiode=100_000),
        lamp(False), Expect(off=(Flag.LAMP_WARM,)), lamp(), Expect(off=(Flag.LAMP_WARM,)),
    )),
    Scenario("the shutter closes by itself", (
        *MET, shutter(500), Pass(0.4), Expect(on=(Flag.SHUTTER,)), Pass(0.2),
        Expect(off=(Flag.SHUTTER,), fault=Fault.NONE),
    )),
    Scenario("opening again begins the longest time anew", (
        *MET, shutter(500), Pass(0.4), shutter(500), Pass(0.4), Expect(on=(Flag.SHUTTER,)), Pass(0.2),
        Expect(off=(Flag.SHUTTER,)),
    )),
    Scenario("a shutter has to have a longest time", (
        *MET, Send(Opcode.SHUTTER, struct.pack("<BI", 1, 0), Status.BAD_ARG), Expect(off=(Flag.SHUTTER,)),
    )),
    Scenario("closing measures the light of the open window", (
        *MET, lamp(), Pass(1), shutter(), Pass(0.5), shutter(0), Expect(off=(Flag.SHUTTER,), photodiode=85_000),
    )),
    Scenario("the light of a window is its mean, however often it is opened again", (
        *MET, shutter(), Pass(1), lamp(), shutter(), Pass(1), shutter(0), Expect(photodiode=42_500),
    )),
    Scenario("a move with the shutter open", (
        *LIT, move(10_000, 0), Pass(5), Expect(on=(Flag.SHUTTER,), job_state=JobState.DONE),
    )),
    # watchdog
    Scenario("the watchdog closes the shutter and leaves the lamp lit", (
        *LIT, watchdog(2000), Expect(on=(Flag.WATCHDOG,)), Pass(1.9), Expect(on=(Flag.SHUTTER,)), Send(Opcode.NOP),
        Pass(1.9), Expect(on=(Flag.SHUTTER,)), Pass(0.2),
        Expect(fault=Fault.WATCHDOG, axis=255, on=(Flag.LAMP, Flag.FAULT), off=(Flag.SHUTTER,)),
    )),
    Scenario("the watchdog stops a move", (
        *HOMED, watchdog(2000), move(80_000, 0), Pass(20),
        Expect(fault=Fault.WATCHDOG, job_state=JobState.FAULTED, moving=0, at=(17_500, 0, 0, 0), within=60),
        *refused(Fault.WATCHDOG), clear(Fault.WATCHDOG), Expect(fault=Fault.NONE, job_state=JobState.IDLE, homed=15),
        move(10_000, 0), Pass(1.5, fed=True), Expect(at=(10_000, 0, 0, 0)),
    )),
    Scenario("a host that feeds the watchdog comes to its target", (
        *HOMED, watchdog(500), move(80_000, 0), Pass(10, fed=True), Expect(fault=Fault.NONE, at=(80_000, 0, 0, 0)),
    )),
    Scenario("a stored reply feeds the watchdog, too", (
        *HOMED, watchdog(1000), shutter(), Pass(0.9), Again(), Pass(0.9), Expect(fault=Fault.NONE), Pass(0.2),
        Expect(fault=Fault.WATCHDOG),
    )),
    Scenario("the watchdog sleeps while nothing runs", (
        *HOMED, watchdog(500), lamp(), Pass(10), Expect(fault=Fault.NONE, on=(Flag.LAMP, Flag.WATCHDOG)),
    )),
    # faults
    Scenario("the emergency stop needs no CRC, and stays until it is named", (
        *LIT, move(80_000, 0), Pass(2), Raw(b"\x0f" + bytes(range(63))),
        Expect(job_state=JobState.FAULTED, axis=255, at=(17_500, 0, 0, 0), within=60, on=(Flag.LAMP,)),
        *refused(Fault.ESTOP), clear(Fault.ESTOP), Expect(fault=Fault.NONE, off=(Flag.FAULT,)), move(0, 0), Pass(5),
        Expect(at=(0, 0, 0, 0)),
    )),
    Scenario("an emergency stop of one byte, before hello", (Raw(b"\x0f"), hello(), *refused(Fault.ESTOP))),
    Scenario("the door", (
        *LIT, move(80_000, 0), Pass(2), Happen("door_open"),
        Expect(job_state=JobState.FAULTED, on=(Flag.INTERLOCK,)), *refused(Fault.INTERLOCK, Status.INTERLOCK),
        clear(Fault.INTERLOCK, Status.BAD_ARG), Send(Opcode.NOP), Happen("door_closed"),
        Expect(fault=Fault.INTERLOCK, off=(Flag.INTERLOCK,)), move(0, 0, reply=Status.FAULTED),
        clear(Fault.INTERLOCK), move(0, 0), Pass(5), Expect(at=(0, 0, 0, 0)),
    )),
    Scenario("a door that is open when the rig starts", (
        *MET, Happen("door_open"), Happen("power_cycle"), hello(),
        Expect(fault=Fault.INTERLOCK, on=(Flag.INTERLOCK,)), home(reply=Status.INTERLOCK),
    )),
    Scenario("an emergency stop while the door is open", (
        *MET, Happen("door_open"), ESTOP, Expect(fault=Fault.ESTOP), clear(Fault.ESTOP),
        home(reply=Status.INTERLOCK), Happen("door_closed"), home(), HOMING, Expect(homed=15),
    )),
    Scenario("a limit switch names its axis", (
        *LIT, move(80_000, 90_000), Pass(2), Happen("limit_switch", 1), Pass(0.1),
        Expect(axis=1, job_state=JobState.FAULTED), *refused(Fault.LIMIT_SWITCH), clear(Fault.LIMIT_SWITCH), home(),
        HOMING, Expect(homed=15, job_state=JobState.DONE),
    )),
    Scenario("an axis that does not follow is a stall", (
        *HOMED, move(80_000, 0), Pass(2), Happen("blocked", 0), Pass(1),
        Expect(axis=0, job_state=JobState.FAULTED, at=(17_500, 0, 0, 0), within=60), *refused(Fault.STALL),
        clear(Fault.STALL), home(), HOMING, Expect(homed=15),
    )),
    Scenario("the lamp goes out", (
        *LIT, Happen("lamp_out"), Pass(0.1), Expect(off=(Flag.LAMP, Flag.SHUTTER)), *refused(Fault.LAMP_OUT),
        clear(Fault.LAMP_OUT), lamp(), Expect(on=(Flag.LAMP,)),
    )),
    Scenario("the lamp is too hot", (
        *LIT, Happen("overheated"), Pass(0.1), Expect(on=(Flag.LAMP,)), *refused(Fault.OVERHEATED),
        clear(Fault.OVERHEATED),
    )),
    Scenario("a later fault takes the place of an earlier one", (
        *HOMED, ESTOP, Happen("door_open"), Expect(fault=Fault.INTERLOCK), Happen("door_closed"),
        clear(Fault.ESTOP, Status.BAD_ARG), clear(Fault.INTERLOCK), Expect(fault=Fault.NONE),
    )),
    # exposures
    Scenario("the release line fires and X-sync edges are counted", (
        *LIT, expose(40_000, 250, gap_ms=100), Expect(jobs=2, job_state=JobState.RUNNING, batch=0), Pass(0.2),
        Expect(batch=1), Pass(0.2), Expect(job_state=JobState.DONE, batch=2, exposures=2),
        expose(*([1000] * 8), gap_ms=10), Pass(0.5), Expect(jobs=3, job_state=JobState.DONE, batch=8, exposures=10),
    )),
    Scenario("a batch that comes twice is exposed once", (
        *MET, expose(1000, 1000), Again(2), Pass(1), Again(), Pass(1), Expect(jobs=1, batch=2, exposures=2),
    )),
    Scenario("an exposure without its X-sync edge is a fault", (
        *LIT, Happen("x_sync_out"), expose(40_000, 40_000), Pass(0.1), Expect(job_state=JobState.RUNNING), Pass(0.1),
        Expect(job_state=JobState.FAULTED, batch=0, exposures=0), *refused(Fault.XSYNC_MISSING),
        clear(Fault.XSYNC_MISSING), Happen("x_sync_in"), expose(1000), Pass(1),
        Expect(job_state=JobState.DONE, batch=1, exposures=1),
    )),
    Scenario("the cable comes out between two exposures", (
        *MET, expose(10_000, 10_000, 10_000), Pass(0.05), Happen("x_sync_out"), Pass(1),
        Expect(fault=Fault.XSYNC_MISSING, batch=1, exposures=1),
    )),
    Scenario("exposures that the host makes are counted, too", (
        *MET, Happen("exposure"), Happen("exposure"), Expect(exposures=2, batch=0, jobs=0),
    )),
    Scenario("exposures are counted from the start", (
        *MET, Happen("exposure"), Happen("exposure"), Happen("power_cycle"), Expect(exposures=0), Happen("exposure"),
        Expect(exposures=1),
    )),
    Scenario("STOP ends a batch", (
        *MET, expose(10_000, 10_000, 10_000, gap_ms=1000), Pass(0.5), stop(), Pass(5),
        Expect(job_state=JobState.STOPPED, exposures=1, fault=Fault.NONE),
    )),
    Scenario("an emergency stop ends a batch", (
        *MET, expose(10_000, 10_000, gap_ms=1000), Pass(0.5), ESTOP, Pass(5), Expect(exposures=1, fault=Fault.ESTOP),
    )),
    # events
    Scenario("events are fast while a job runs", (
        *HOMED, Pass(0.5), Events(3, 3), move(30_000, 0), Events(2, 20), Pass(5), Events(4, 4),
    )),
    Scenario("an event tells the end of a job at once", (
        *HOMED, move(30_000, 0, settle_ms=40), Pass(3.51), Events(0.06, 1), Expect(job_state=JobState.DONE),
        Events(0.9, 0),
    )),
    Scenario("an event tells a fault at once", (*HOMED, ESTOP, Events(0.9, 1))),
    # configuration
    Scenario("narrower limits are kept, over a power cycle, too", (
        *HOMED, Configure(True, {"high": (45_000, *FULL[1:])}), move(50_000, 0, reply=Status.LIMIT),
        move(45_000, 0), Pass(10), Happen("power_cycle"), hello(), watchdog(0), home(), HOMING,
        move(50_000, 0, reply=Status.LIMIT),
    )),
    Scenario("no configuration stretches the machine", (
        *MET, Configure(False, {"high": (95_000, *FULL[1:])}),
        Configure(False, {"low": (-1, -10_000, -75_000, -360_000)}),
        Configure(False, {"speeds": (1001, 3000, 1000, 3000)}), Configure(False, {"accelerations": (21, 60, 20, 60)}),
        Configure(False, {"low": (50_000, -10_000, -75_000, -360_000), "high": (40_000, *FULL[1:])}),
        home(), HOMING, move(50_000, 0), Pass(7), Expect(at=(50_000, 0, 0, 0)),
    )),
    Scenario("a slower configuration is a slower rig", (
        *HOMED, Configure(True, {"speeds": (500, 3000, 1000, 3000), "accelerations": (5, 60, 20, 60)}),
        move(20_000, 0), Pass(4.9), Expect(job_state=JobState.RUNNING), Pass(0.2), Expect(job_state=JobState.DONE),
    )),
    Scenario("a configuration waits for the end of a job", (
        *HOMED, move(80_000, 0), Configure(False, {"watchdog_ms": 1000}), Pass(10),
        Configure(True, {"watchdog_ms": 1000}),
    )),
    Scenario("the watchdog at start can be configured", (
        hello(), Configure(True, {"watchdog_ms": 500}), Happen("power_cycle"), hello(), shutter(), Pass(0.6),
        Expect(fault=Fault.WATCHDOG), clear(Fault.WATCHDOG), Configure(True, {"watchdog_ms": 0}),
        Happen("power_cycle"), hello(), shutter(), Pass(5), Expect(fault=Fault.NONE, off=(Flag.WATCHDOG,)),
    )),
]  # fmt: skip
"""The table."""
