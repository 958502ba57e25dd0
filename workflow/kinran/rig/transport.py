"""HID handles: the real device through hidapi, and a simulated one that behaves like hidapi.

hidapi reports a failed write as -1 without an exception, a timed-out read as [], and blocks for ever on
``read(n)`` and ``read(n, 0)``: a time-out is never left out here.
"""

import importlib
import os
import sys
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

from kinran.rig.firmware import Firmware

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

VENDOR, PRODUCT = 0x1209, 0x0001
"""The test pair of pid.codes; the real pair comes from the configuration."""

NODES = b"/dev/"
"""Folder of the nodes of devices."""
UDEV_RULE = "70-kinran-rig.rules"
"""File of the rule in docs/rig.md that lets users open the rig."""
ACCESS = "run `kinran rig install-udev` and reconnect the rig, or end the program that holds it"
"""Remedy where a rig cannot be opened: hidapi does not tell why."""
Backend = Literal["hidraw", "libusb"]


class TransportError(Exception):
    """No handle can be opened; the message says why and the remedy."""


class Handle(Protocol):
    """The interface of a HID handle to the driver: methods of ``hid.device``."""

    def write(self, data: bytes) -> int:
        """Send an output report; return the number of bytes, or -1."""

    def read(self, max_length: int, timeout_ms: int) -> list[int]:
        """Return the next input report, or [] after the time-out."""

    def send_feature_report(self, data: bytes) -> int:
        """Set a feature; return the number of bytes, or -1."""

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        """Return a feature.

        Raises
        ------
        OSError
            The device did not answer.
        """

    def close(self) -> None:
        """Close the handle."""


def hid_module() -> Any:
    """Return the module of hidapi: ``hidraw`` (the kernel's driver, in the Linux wheel) or else ``hid``.

    Raises
    ------
    TransportError
        Neither is installed, or another package's ``hid`` hides it.
    """
    names = ["hidraw", "hid"] if sys.platform == "linux" else ["hid"]
    for name in names:
        try:
            module = importlib.import_module(name)
        except ImportError:
            continue
        if hasattr(module, "device") and hasattr(module, "version_str"):
            return module
    raise TransportError(
        "Python's module 'hid' is not hidapi's; run: pip uninstall hid; pip install --force-reinstall hidapi"
    )


@dataclass(frozen=True)
class Opened:
    """An open handle, with the path and the serial number of its device."""

    handle: Handle
    path: bytes
    serial: str


def open_hid(serial: str | None = None, vendor: int = VENDOR, product: int = PRODUCT) -> Opened:
    """Open the rig with this serial number, or the only one.

    Raises
    ------
    TransportError
        None is connected, several are and no serial number was given, or this user may not open it.
    """
    module = hid_module()
    found = module.enumerate(vendor, product)
    pair = f"{vendor:04x}:{product:04x}"
    names = ", ".join(info["serial_number"] or "?" for info in found)
    fitting = [info for info in found if serial in (None, info["serial_number"])]
    if not found:
        raise TransportError(f"no rig ({pair}) is connected; check its cable and power")
    if not fitting and not all(info["serial_number"] for info in found):  # libusb reads none where it may not open
        raise TransportError(f"the serial number of a rig ({pair}) cannot be read; {ACCESS}")
    if not fitting:
        raise TransportError(f"no rig ({pair}) has the serial number {serial}; connected: {names}")
    if len(fitting) > 1:
        raise TransportError(f"several rigs ({pair}) are connected: {names}; give --serial")
    device = module.device()
    try:
        device.open_path(fitting[0]["path"])
    except OSError:
        where = fitting[0]["path"].decode(errors="replace")
        raise TransportError(f"the rig at {where} cannot be opened; {ACCESS}") from None
    return Opened(device, fitting[0]["path"], fitting[0]["serial_number"])


@contextmanager
def rig_lock(path: bytes, serial: str) -> Iterator[None]:
    """Lock the rig for this process: hidraw would let two programs drive it.

    The lock is on the node of the device itself, so that it holds for all users and settings of this machine. Where
    the rig is reached without a node (libusb), its claim on the interface is the lock.

    Parameters
    ----------
    path
        Path of the device, as hidapi names it.
    serial
        Serial number, to name in an error.

    Raises
    ------
    TransportError
        Another program drives the rig.
    """
    if fcntl is None or not path.startswith(NODES):
        yield
        return
    try:
        node = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        raise TransportError(f"the rig {serial} is disconnected; check its cable and power") from None
    try:
        fcntl.flock(node, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        holder = _holder(node)
        os.close(node)
        raise TransportError(f"another program{holder} drives the rig {serial}; end it first") from None
    try:
        yield
    finally:
        os.close(node)


def _holder(node: int) -> str:
    """Return the name and number of the process that has a file locked, where the system tells."""
    where = os.fstat(node)
    wanted = f"{os.major(where.st_dev):02x}:{os.minor(where.st_dev):02x}:{where.st_ino}"
    try:
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if len(words) > 5 and words[1] == "FLOCK" and words[5] == wanted:
                name = Path(f"/proc/{words[4]}/comm").read_text().strip()
                return f" ({name}, process {words[4]})"
    except OSError:
        pass
    return ""


class SimulatedHid:
    """A handle on a simulated rig that behaves like one of hidapi's Linux back-ends.

    Waiting advances the firmware's virtual clock, so that it takes no real time.
    """

    def __init__(self, firmware: Firmware, backend: Backend = "hidraw") -> None:
        self.firmware = firmware
        self.backend = backend
        self.lost = 0
        self._queue: deque[bytes] = deque()
        self._open = True

    def write(self, data: bytes) -> int:
        """Send an output report."""
        self._check_open()
        if not self.firmware.plugged or len(data) < (2 if self.backend == "hidraw" else 1):
            return -1
        self.firmware.on_output(bytes(data))
        if not self.firmware.plugged:
            return -1
        self.firmware.advance(0.001)  # one interrupt interval
        return len(data)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """Return the next input report; a time-out of 0, which would block for ever on a real handle, is an error."""
        self._check_open()
        if timeout_ms <= 0:
            raise RuntimeError("read without a time-out blocks for ever")
        until = self.firmware.clock + timeout_ms / 1000
        while True:
            self._check_plugged("read error")
            self._collect()
            if self._queue:
                return list(self._queue.popleft()[:max_length])
            step = min(self.firmware.next_due(), until) - self.firmware.clock
            self.firmware.advance(max(step, 0.0))
            self._collect()
            if not self._queue and self.firmware.clock >= until:
                return []

    def send_feature_report(self, data: bytes) -> int:
        """Set a feature."""
        self._check_open()
        if not self.firmware.plugged or not self.firmware.set_feature(bytes(data)):
            return -1
        return len(data)

    def get_feature_report(self, report_num: int, max_length: int) -> list[int]:
        """Return a feature; an unanswered request takes 5 s (hidraw) or 1 s (libusb)."""
        self._check_open()
        self._check_plugged("get feature error")
        answer = self.firmware.get_feature(report_num)
        if answer is None:
            self.firmware.advance(5.0 if self.backend == "hidraw" else 1.0)
            raise OSError("get feature error")
        return list(answer[:max_length])

    def close(self) -> None:
        """Close the handle."""
        self._open = False

    def _check_open(self) -> None:
        if not self._open:
            raise ValueError("not open")

    def _check_plugged(self, message: str) -> None:
        if not self.firmware.plugged:
            raise OSError(message)

    def _collect(self) -> None:
        """Queue what the firmware sent; hidraw keeps the oldest 63 reports, libusb the newest 32."""
        outbox = self.firmware.outbox
        while outbox:
            self._queue.append(outbox.popleft())
            if self.backend == "hidraw" and len(self._queue) > 63:
                self._queue.pop()
                self.lost += 1
            if self.backend == "libusb" and len(self._queue) > 32:
                self._queue.popleft()
                self.lost += 1
