"""The rig as a HID device of /dev/uhid (linux/uhid.h): no USB is in between."""

import os
import struct
from enum import IntEnum

from emulated_rig import PRODUCT_NAME, RELEASE, SERIAL, Rig

from kinran.rig.protocol import descriptor
from kinran.rig.transport import PRODUCT, VENDOR


class Event(IntEnum):
    """Types of events (linux/uhid.h, enum uhid_event_type)."""

    DESTROY = 1
    OUTPUT = 6
    GET_REPORT = 9
    GET_REPORT_REPLY = 10
    CREATE2 = 11
    INPUT2 = 12
    SET_REPORT = 13
    SET_REPORT_REPLY = 14


SIZE = 4 + 128 + 64 + 64 + 2 + 2 + 4 * 4 + 4096
"""Bytes of an event: its type and the largest body, that of CREATE2."""
BUS_USB = 3
"""Bus that the device says it is on, so that the rule of udev for hidraw fits it."""
DATA = 4096
"""Bytes of the data in an OUTPUT event, after which its size stands."""
EIO = 5
"""Error of a request that the rig refuses."""


class Uhid:
    """Link to the kernel through /dev/uhid."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._file = os.open("/dev/uhid", os.O_RDWR | os.O_CLOEXEC)
        self._plugged = False

    def plug(self) -> None:
        """Make the device."""
        described = descriptor()
        names = PRODUCT_NAME.encode(), b"kinran", SERIAL.encode()
        head = struct.pack("<I128s64s64sHH", Event.CREATE2, *names, len(described), BUS_USB)
        self._write(head + struct.pack("<IIII", VENDOR, PRODUCT, RELEASE, 0) + described)
        self._plugged = True

    def unplug(self) -> None:
        """Destroy the device."""
        if self._plugged:
            self._write(struct.pack("<I", Event.DESTROY))
        self._plugged = False

    def files(self) -> list[int]:
        """Return the file of uhid."""
        return [self._file]

    def send(self, report: bytes) -> None:
        """Send an input report."""
        if self._plugged:
            self._write(struct.pack("<IH", Event.INPUT2, len(report)) + report)

    def serve(self) -> None:
        """Handle one event of the kernel."""
        event = os.read(self._file, SIZE)
        match struct.unpack_from("<I", event)[0]:
            case Event.OUTPUT:
                size = struct.unpack_from("<H", event, 4 + DATA)[0]
                self.rig.on_output(event[4 : 4 + size])
            case Event.GET_REPORT:
                number, report = struct.unpack_from("<IB", event, 4)
                if self.rig.answers(report):
                    answer = self.rig.get_feature(report) or b""
                    error = 0 if answer else EIO
                    self._write(struct.pack("<IIHH", Event.GET_REPORT_REPLY, number, error, len(answer)) + answer)
            case Event.SET_REPORT:
                number, _, _, size = struct.unpack_from("<IBBH", event, 4)
                error = 0 if self.rig.set_feature(event[12 : 12 + size]) else EIO
                self._write(struct.pack("<IIH", Event.SET_REPORT_REPLY, number, error))

    def _write(self, event: bytes) -> None:
        os.write(self._file, event.ljust(SIZE, b"\0"))
