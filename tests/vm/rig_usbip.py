"""The rig as a full-speed USB device: a USB/IP server whose socket the guest's vhci_hcd reads.

The formats are those of the kernel's Documentation/usb/usbip_protocol.rst, of USB 2.0 chapter 9, and of HID 1.11.
"""

import collections
import socket
import struct
from pathlib import Path

from emulated_rig import PRODUCT_NAME, RELEASE, SERIAL, Rig

from kinran.rig.protocol import REPORT, descriptor
from kinran.rig.transport import PRODUCT, VENDOR

VHCI = Path("/sys/devices/platform/vhci_hcd.0")
"""The virtual host controller."""
FREE_PORT = "004"
"""Status of a port that nothing is attached to (vhci_hcd: VDEV_ST_NULL)."""
FULL_SPEED = 2
"""Speed of the device (linux/usb/ch9.h: USB_SPEED_FULL)."""
DEVICE_ID = 1 << 16 | 2
"""Number of bus and device that the server gives it: any."""
SUBMIT, UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
"""Commands of USB/IP, and their answers."""
STALLED, UNLINKED = -32, -104
"""Status of a request that the device refuses (EPIPE), and of one that the host took back (ECONNRESET)."""
STRINGS = {1: "Kinran", 2: PRODUCT_NAME, 3: SERIAL}
"""Strings of the device: manufacturer, product, serial number."""
LANGUAGES = b"\x04\x03\x09\x04"
"""String 0: English."""
KEPT = 512
"""Input reports that the device keeps while the host takes none."""

_HEADER = struct.Struct(">IIIII")
_SUBMITTED = struct.Struct(">Iiiii8s")
_DONE = struct.Struct(">iiiii8x")


def device_descriptor() -> bytes:
    """Return the descriptor of the device."""
    return struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0200, 0, 0, 0, 64, VENDOR, PRODUCT, RELEASE, 1, 2, 3, 1)


def hid_descriptor() -> bytes:
    """Return the descriptor of HID, which says how long the report descriptor is."""
    return struct.pack("<BBHBBBH", 9, 0x21, 0x0111, 0, 1, 0x22, len(descriptor()))


def configuration_descriptor() -> bytes:
    """Return the descriptors of configuration, interface, HID and of an interrupt endpoint each way."""
    interface = struct.pack("<BBBBBBBBB", 9, 4, 0, 0, 2, 3, 0, 0, 0)
    endpoints = b"".join(struct.pack("<BBBBHB", 7, 5, address, 3, REPORT, 1) for address in (0x81, 0x01))
    body = interface + hid_descriptor() + endpoints
    return struct.pack("<BBHBBBBB", 9, 2, 9 + len(body), 1, 1, 0, 0x80, 50) + body


def string_descriptor(number: int) -> bytes | None:
    """Return a string of the device; None where it has none of this number."""
    if number == 0:
        return LANGUAGES
    if number not in STRINGS:
        return None
    text = STRINGS[number].encode("utf-16-le")
    return bytes([len(text) + 2, 3]) + text


class UsbIp:
    """Link to the kernel through vhci_hcd."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self._socket: socket.socket | None = None
        self._waiting: collections.deque[int] = collections.deque()
        self._kept: collections.deque[bytes] = collections.deque(maxlen=KEPT)
        self._held: list[int] = []

    def plug(self) -> None:
        """Attach one end of a pair of sockets to a free port, and serve the other."""
        ours, theirs = socket.socketpair()
        rows = [line.split() for line in (VHCI / "status").read_text().splitlines()]
        port = next(int(row[1]) for row in rows if row[0] == "hs" and row[2] == FREE_PORT)
        (VHCI / "attach").write_text(f"{port} {theirs.fileno()} {DEVICE_ID} {FULL_SPEED}")
        theirs.close()
        self.serve_on(ours)

    def serve_on(self, ours: socket.socket) -> None:
        """Serve a host at the other end of a socket."""
        self._socket = ours
        self._waiting.clear()
        self._kept.clear()
        self._held.clear()

    def unplug(self) -> None:
        """Close the socket, which is a disconnect to the host."""
        if self._socket:
            self._socket.close()
        self._socket = None

    def files(self) -> list[int]:
        """Return the socket."""
        return [self._socket.fileno()] if self._socket else []

    def send(self, report: bytes) -> None:
        """Send an input report, of which the wire carries no more than 64 bytes."""
        if self._waiting:
            self._done(self._waiting.popleft(), report[:REPORT])
        else:
            self._kept.append(report[:REPORT])

    def serve(self) -> None:
        """Handle one request of the host."""
        try:
            command, number, _, reads, endpoint = _HEADER.unpack(self._take(_HEADER.size))
            wanted, length, _, _, _, setup = _SUBMITTED.unpack(self._take(_SUBMITTED.size))
            if command == UNLINK:
                self._unlink(number, wanted)
                return
            data = b"" if reads or length <= 0 else self._take(length)
        except ConnectionError:
            self.unplug()
            return
        if endpoint:
            self._interrupt(number, bool(reads), data)
        else:
            self._control(number, setup, data)

    def _interrupt(self, number: int, reads: bool, data: bytes) -> None:
        """Handle a transfer on an interrupt endpoint."""
        if reads and self._kept:
            self._done(number, self._kept.popleft())
        elif reads:
            self._waiting.append(number)
        elif self.rig.refusing:
            self.rig.refusing = False
            self._done(number, status=STALLED)
        else:
            self._done(number, taken=len(data))
            self.rig.on_output(data)

    def _control(self, number: int, setup: bytes, data: bytes) -> None:
        """Handle a transfer on the control endpoint."""
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        if (kind, request) == (0xA1, 1) and not self.rig.answers(value & 0xFF):  # GET_REPORT
            self._held.append(number)
            return
        answer = self._answer(kind, request, value, data)
        if answer is None:
            self._done(number, status=STALLED)
        elif kind & 0x80:
            self._done(number, answer[:length])
        else:
            self._done(number, taken=len(data))

    def _answer(self, kind: int, request: int, value: int, data: bytes) -> bytes | None:
        """Return what the device answers to a request; None where it refuses."""
        high, low = value >> 8, value & 0xFF
        match kind, request:
            case 0x80, 6:  # GET_DESCRIPTOR
                described = {1: device_descriptor(), 2: configuration_descriptor()}
                return string_descriptor(low) if high == 3 else described.get(high)
            case 0x81, 6:  # GET_DESCRIPTOR of the interface
                return {0x21: hid_descriptor(), 0x22: descriptor()}.get(high)
            case 0xA1, 1:  # GET_REPORT
                return self.rig.get_feature(low)
            case 0x21, 9 if high == 3:  # SET_REPORT of a feature
                return b"" if self.rig.set_feature(data) else None
            case 0x21, 9:  # SET_REPORT of an output report
                self.rig.on_output(data)
                return b""
            case 0x80, 0:  # GET_STATUS
                return b"\0\0"
            case ((0x00 | 0x01 | 0x02 | 0x21), _):  # SET_CONFIGURATION, SET_IDLE, CLEAR_FEATURE
                return b""
        return None

    def _unlink(self, number: int, wanted: int) -> None:
        """Take back a request that waits, and say whether it still did."""
        status = 0
        for waiting in (self._waiting, self._held):
            if wanted in waiting:
                waiting.remove(wanted)
                status = UNLINKED
        self._answer_with(RET_UNLINK, number, status, b"", 0)

    def _done(self, number: int, data: bytes = b"", status: int = 0, taken: int | None = None) -> None:
        """Answer a request with data, with the number of bytes that the device took, or with an error."""
        self._answer_with(RET_SUBMIT, number, status, data, len(data) if taken is None else taken)

    def _answer_with(self, command: int, number: int, status: int, data: bytes, length: int) -> None:
        if self._socket:
            try:
                self._socket.sendall(
                    _HEADER.pack(command, number, 0, 0, 0) + _DONE.pack(status, length, 0, 0, 0) + data
                )
            except OSError:  # the host is gone
                self.unplug()

    def _take(self, length: int) -> bytes:
        """Read so many bytes of the host's."""
        taken = b""
        while len(taken) < length:
            assert self._socket is not None
            part = self._socket.recv(length - len(taken))
            if not part:
                raise ConnectionError
            taken += part
        return taken
