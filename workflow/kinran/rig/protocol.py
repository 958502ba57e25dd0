"""The wire protocol of the goniometer: 64-byte HID reports, little endian, protected by a CRC-32.

A report is a 12-byte header, 48 bytes of payload and the CRC of both (docs/rig.md has the tables).
Angles are millidegrees; the four axes are light θ, light φ, camera θ, camera φ.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

REPORT = 64
"""Bytes of a report, and the most that an interrupt endpoint of a full-speed USB device takes at once."""
PAYLOAD = 48
"""Bytes of a report's payload: what header and CRC leave."""
VERSION = 1
"""Version of the protocol."""
VALIDATE_ONLY = 1
"""Flag of a command that is only checked, not executed."""
COORDINATED = 1
"""Flag of a move whose axes arrive at once."""
X_SYNC = 1
"""Bit of IDENT's capabilities: the rig counts the camera's exposures."""
USAGE_PAGE, USAGE = 0xFF4B, 0x01
"""HID usage of the rig, on a page reserved for vendors."""

Four = tuple[int, int, int, int]

_HEADER = struct.Struct("<BBHBBBBI")
_CRC = struct.Struct("<I")
_STATE = struct.Struct("<I4iHHBBBBIIHHIi")
_MOVE = struct.Struct("<BBH4i4I")
_EXPOSE = struct.Struct("<BxH8I")
_IDENT = struct.Struct("<HHHH16sB")
_CONFIG = struct.Struct("<8i4H4BHH")
_CONFIG_1_0 = struct.Struct("<8i4H4BH")


class ProtocolError(ValueError):
    """Bytes that are not a report of this protocol."""


class ReportId(IntEnum):
    """Report ids; the first is host to rig, REPLY and EVENT are rig to host, the rest features."""

    COMMAND = 0x01
    REPLY = 0x02
    EVENT = 0x03
    IDENT = 0x04
    CONFIG = 0x05
    STATUS = 0x06
    ESTOP = 0x0F


class Status(IntEnum):
    """Status codes of a REPLY."""

    OK = 0
    ACCEPTED = 1
    BUSY = 2
    BAD_CRC = 3
    BAD_ARG = 4
    LIMIT = 5
    NOT_HOMED = 6
    FAULTED = 7
    INTERLOCK = 8
    STALE_BOOT = 9
    UNSUPPORTED = 10
    BAD_SEQ = 11
    COLLISION = 12


class Opcode(IntEnum):
    """Opcodes of commands."""

    NOP = 0x00
    HELLO = 0x01
    HOME = 0x10
    MOVE = 0x11
    STOP = 0x12
    CLEAR = 0x13
    LAMP = 0x20
    SHUTTER = 0x21
    INTENSITY = 0x22
    EXPOSE = 0x30
    WATCHDOG = 0x40


class Fault(IntEnum):
    """Latched faults; CLEAR must name the one that was seen."""

    NONE = 0
    ESTOP = 1
    LIMIT_SWITCH = 2
    STALL = 3
    LAMP_OUT = 4
    WATCHDOG = 5
    SHUTTER = 6
    OVERHEATED = 7
    INTERLOCK = 8
    XSYNC_MISSING = 9
    COLLISION = 10


class JobState(IntEnum):
    """State of the last job."""

    IDLE = 0
    RUNNING = 1
    DONE = 2
    STOPPED = 3
    FAULTED = 4


class Flag(IntEnum):
    """Bits of the status flags; HOMED and MOVING take four bits each, one an axis."""

    HOMED = 0
    MOVING = 4
    SHUTTER = 8
    LAMP = 9
    WATCHDOG = 10
    FAULT = 11
    INTERLOCK = 12
    LAMP_WARM = 13


@dataclass(frozen=True)
class Report:
    """One report.

    Attributes
    ----------
    id
        Report id.
    seq
        1 to 65535; 0 in EVENT and FEATURE reports.
    opcode
        Command, echoed in its reply.
    code
        Flags of a command, status of a reply.
    job
        Job that runs or ran last.
    boot
        Boot id: random at each start of the firmware.
    payload
        At most 48 bytes.
    """

    id: int
    seq: int = 0
    opcode: int = 0
    code: int = 0
    job: int = 0
    boot: int = 0
    payload: bytes = b""

    def pack(self) -> bytes:
        """Return the 64 bytes of the report."""
        if len(self.payload) > PAYLOAD:
            raise ProtocolError(f"a payload of {len(self.payload)} bytes does not fit in {PAYLOAD}")
        header = _HEADER.pack(
            self.id, VERSION, self.seq, self.opcode, self.code, len(self.payload), self.job, self.boot
        )
        body = header + self.payload.ljust(PAYLOAD, b"\0")
        return body + _CRC.pack(zlib.crc32(body))

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read 64 bytes.

        Raises
        ------
        ProtocolError
            Length, CRC, version or payload length is wrong.
        """
        if len(data) != REPORT:
            raise ProtocolError(f"a report has {REPORT} bytes, not {len(data)}")
        if zlib.crc32(data[:-4]) != _CRC.unpack_from(data, REPORT - 4)[0]:
            raise ProtocolError("the CRC of a report does not match its bytes")
        id_, version, seq, opcode, code, length, job, boot = _HEADER.unpack_from(data)
        if version != VERSION:
            raise ProtocolError(f"protocol version {version} is not {VERSION}")
        if length > PAYLOAD:
            raise ProtocolError(f"payload length {length} is over {PAYLOAD}")
        return cls(id_, seq, opcode, code, job, boot, data[12 : 12 + length])


def _fields(layout: struct.Struct, data: bytes, what: str) -> tuple[int, ...]:
    if len(data) != layout.size:
        raise ProtocolError(f"{what} has {layout.size} bytes, not {len(data)}")
    return layout.unpack(data)


@dataclass(frozen=True)
class State:
    """The STATUS block: the rig's state, in every event and most replies (docs/rig.md has the units)."""

    uptime_ms: int = 0
    position: Four = (0, 0, 0, 0)
    flags: int = 0
    fault: int = 0
    fault_axis: int = 0xFF
    job: int = 0
    job_state: int = 0
    batch: int = 0
    exposures: int = 0
    photodiode: int = 0
    lamp_temperature: int = 0
    lamp_hours: int = 0
    event: int = 0
    following_error: int = 0

    def pack(self) -> bytes:
        """Return the 48 bytes of the block."""
        return _STATE.pack(
            self.uptime_ms,
            *self.position,
            self.flags,
            self.fault,
            self.fault_axis,
            self.job,
            self.job_state,
            self.batch,
            self.exposures,
            self.photodiode,
            self.lamp_temperature,
            self.lamp_hours,
            self.event,
            self.following_error,
        )

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the 48 bytes of the block."""
        v = _fields(_STATE, data, "a status block")
        return cls(v[0], (v[1], v[2], v[3], v[4]), *v[5:])

    def has(self, flag: Flag) -> bool:
        """Return whether a single-bit flag is set."""
        return bool(self.flags >> flag & 1)

    @property
    def homed(self) -> int:
        """Mask of homed axes."""
        return self.flags >> Flag.HOMED & 15

    @property
    def moving(self) -> int:
        """Mask of moving axes."""
        return self.flags >> Flag.MOVING & 15


@dataclass(frozen=True)
class Move:
    """Payload of MOVE: targets in millidegrees, top speeds in mdeg/s (0: the axis' own)."""

    mask: int
    targets: Four
    settle_ms: int = 0
    speeds: Four = (0, 0, 0, 0)
    flags: int = COORDINATED

    def pack(self) -> bytes:
        """Return the 36 bytes of the payload."""
        return _MOVE.pack(self.mask, self.flags, self.settle_ms, *self.targets, *self.speeds)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the 36 bytes of the payload."""
        v = _fields(_MOVE, data, "a move")
        return cls(v[0], (v[3], v[4], v[5], v[6]), v[2], (v[7], v[8], v[9], v[10]), v[1])


@dataclass(frozen=True)
class Expose:
    """Payload of EXPOSE: up to 8 open times in microseconds and the gap between them."""

    open_us: tuple[int, ...]
    gap_ms: int = 0

    def pack(self) -> bytes:
        """Return the 36 bytes of the payload."""
        if not 1 <= len(self.open_us) <= 8:
            raise ProtocolError(f"a batch has 1 to 8 exposures, not {len(self.open_us)}")
        padded = [*self.open_us, *[0] * (8 - len(self.open_us))]
        return _EXPOSE.pack(len(self.open_us), self.gap_ms, *padded)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the 36 bytes of the payload."""
        count, gap, *times = _fields(_EXPOSE, data, "a batch of exposures")
        if not 1 <= count <= 8:
            raise ProtocolError(f"a batch has 1 to 8 exposures, not {count}")
        return cls(tuple(times[:count]), gap)


@dataclass(frozen=True)
class Ident:
    """Payload of the IDENT feature; capability bit 0 is an X-sync counter."""

    firmware: int
    serial: str
    capabilities: int = 0
    reset_cause: int = 0
    major: int = 1
    minor: int = 1

    def pack(self) -> bytes:
        """Return the 25 bytes of the payload."""
        name = self.serial.encode("ascii")
        return _IDENT.pack(self.major, self.minor, self.firmware, self.capabilities, name, self.reset_cause)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the 25 bytes of the payload."""
        if len(data) != _IDENT.size:
            raise ProtocolError(f"an identity has {_IDENT.size} bytes, not {len(data)}")
        major, minor, firmware, capabilities, name, cause = _IDENT.unpack(data)
        serial = name.rstrip(b"\0").decode("ascii", "replace")
        return cls(firmware, serial, capabilities, cause, major, minor)


@dataclass(frozen=True)
class Config:
    """Payload of the CONFIG feature.

    Attributes
    ----------
    low, high
        Soft limits in millidegrees.
    speeds
        Top speeds, in units of 10 mdeg/s; 0 where the rig does not say.
    accelerations
        Accelerations in deg/s²; 0 where the rig does not say.
    watchdog_ms
        Watchdog's time at start-up in milliseconds.
    homing_s
        Longest time of homing in seconds; 0 where the rig does not say, as in protocol 1.0.
    """

    low: Four
    high: Four
    speeds: Four
    accelerations: Four
    watchdog_ms: int
    homing_s: int = 0

    def pack(self) -> bytes:
        """Return the 48 bytes of the payload."""
        limits = [v for pair in zip(self.low, self.high, strict=True) for v in pair]
        return _CONFIG.pack(*limits, *self.speeds, *self.accelerations, self.watchdog_ms, self.homing_s)

    @classmethod
    def unpack(cls, data: bytes) -> Self:
        """Read the 48 bytes of the payload, or the 46 of protocol 1.0."""
        v = _fields(_CONFIG_1_0 if len(data) == _CONFIG_1_0.size else _CONFIG, data, "a configuration")
        return cls(
            (v[0], v[2], v[4], v[6]),
            (v[1], v[3], v[5], v[7]),
            (v[8], v[9], v[10], v[11]),
            (v[12], v[13], v[14], v[15]),
            v[16],
            *v[17:],
        )

    def within(self, factory: Self) -> bool:
        """Return whether a machine whose own configuration is `factory` can be configured like this."""
        limits = zip(factory.low, self.low, self.high, factory.high, strict=True)
        own = (*factory.speeds, *factory.accelerations)
        motion = zip((*self.speeds, *self.accelerations), own, strict=True)
        return all(a <= b <= c <= d for a, b, c, d in limits) and all(value <= most for value, most in motion)


def estop_report() -> bytes:
    """Return the emergency stop, which has no CRC and no seq, so that nothing can refuse it."""
    return bytes([ReportId.ESTOP]).ljust(REPORT, b"\0")


def descriptor() -> bytes:
    """Return the HID report descriptor of the rig."""
    head = bytes([0x06, USAGE_PAGE & 0xFF, USAGE_PAGE >> 8, 0x09, USAGE, 0xA1, 0x01])
    head += bytes([0x15, 0x00, 0x26, 0xFF, 0x00, 0x75, 0x08, 0x95, REPORT - 1])
    kinds = {ReportId.COMMAND: 0x91, ReportId.ESTOP: 0x91, ReportId.REPLY: 0x81, ReportId.EVENT: 0x81}
    items = [
        bytes([0x85, report, 0x09, report, kinds.get(report, 0xB1), 0x02])
        for report in (
            ReportId.COMMAND,
            ReportId.ESTOP,
            ReportId.REPLY,
            ReportId.EVENT,
            ReportId.IDENT,
            ReportId.CONFIG,
            ReportId.STATUS,
        )
    ]
    return head + b"".join(items) + b"\xc0"
