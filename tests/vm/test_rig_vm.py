"""The suite rig-vm without a virtual machine: its verdict, and the USB device that it shows the kernel."""

import contextlib
import os
import shutil
import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import emulated_rig
import pytest
import rig_usbip
import rig_vm
import virtual_machine
from virtual_machine import Kernel, SetupError

from kinran.rig.protocol import REPORT, Opcode, Report, ReportId, Status, descriptor

END = [f"@end {setup}" for setup in rig_vm.SETUPS]


def verdict(monkeypatch: pytest.MonkeyPatch, lines: list[str]) -> int:
    """Exit status of the suite if the guest prints these lines."""

    @contextlib.contextmanager
    def packed(*_: Any) -> Iterator[Path]:
        yield Path("initramfs")

    monkeypatch.setattr(rig_vm, "install_tools", lambda: None)
    monkeypatch.setattr(rig_vm, "kernel", lambda: Kernel("linux", Path("vmlinux"), []))
    monkeypatch.setattr(rig_vm, "initramfs", packed)
    monkeypatch.setattr(rig_vm, "boot", lambda *_: iter(lines))
    return rig_vm.main([])


@pytest.mark.parametrize(
    ("lines", "status", "last"),
    [
        (["ok   a", "note b", "ok   c", *END], 0, "2 passed, 0 failed"),
        (["ok   a", "FAIL b", *END], 1, "1 passed, 1 failed"),
        (["ok   a", *END[:2]], 1, "1 passed, 1 failed"),
        (END, 1, "0 passed, 0 failed"),
        ([], 1, "0 passed, 3 failed"),
        (["ok   a", "@needs hidapi: it is not there", *END], 2, "SETUP ERROR: the guest needs hidapi: it is not there"),
    ],
)
def test_the_verdict(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], lines: list[str], status: int, last: str
) -> None:
    assert verdict(monkeypatch, lines) == status
    assert capsys.readouterr().out.splitlines()[-1] == last


def test_a_missing_tool_is_named_with_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    monkeypatch.setattr(shutil, "which", lambda name, path=None: None)
    with pytest.raises(SetupError, match="sudo apt-get install busybox-static cpio kmod qemu-system-x86 udev"):
        virtual_machine.install_tools()


def test_a_guest_that_does_not_boot_is_no_pass(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    qemu = tmp_path / "qemu-system-x86_64"
    qemu.write_text("#!/bin/sh\necho no memory >&2\nexit 1\n")
    qemu.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(SetupError, match=r"linux does not reach init .*no memory"):
        list(virtual_machine.boot(Kernel("linux", tmp_path, []), tmp_path))


class Host:
    """The kernel's side of USB/IP."""

    def __init__(self) -> None:
        self.rig = emulated_rig.Rig()
        self.link = rig_usbip.UsbIp(self.rig)
        self.socket, theirs = socket.socketpair()
        self.link.serve_on(theirs)
        self._number = 0

    def submit(self, endpoint: int, reads: int, length: int, setup: bytes = bytes(8), data: bytes = b"") -> int:
        self._number += 1
        header = struct.pack(">IIIII", 1, self._number, 0, reads, endpoint)
        self.socket.sendall(header + struct.pack(">Iiiii8s", 0, length, 0, 0, 0, setup) + data)
        self.link.serve()
        return self._number

    def answer(self) -> tuple[int, int, bytes]:
        """Return the number of the request that was answered, its status and its data."""
        self.socket.settimeout(5)
        _, number, _, _, _, status, length = struct.unpack(">IIIIIii20x", self.socket.recv(48))
        return number, status, self.socket.recv(REPORT * 4) if status == 0 and length and self.reads else b""

    reads = True

    def control(self, kind: int, request: int, value: int, length: int = 255, data: bytes = b"") -> tuple[int, bytes]:
        self.reads = bool(kind & 0x80)
        setup = struct.pack("<BBHHH", kind, request, value, 0, len(data) or length)
        self.submit(0, int(self.reads), len(data) or length, setup, data)
        _, status, answer = self.answer()
        return status, answer


@pytest.fixture
def host() -> Iterator[Host]:
    """A kernel that the rig is plugged into."""
    host = Host()
    yield host
    host.link.unplug()
    host.socket.close()


def test_the_usb_device_describes_itself(host: Host) -> None:
    status, device = host.control(0x80, 6, 0x0100, 18)
    assert (status, device[8:12]) == (0, struct.pack("<HH", 0x1209, 1))
    status, configuration = host.control(0x80, 6, 0x0200)
    assert status == 0
    assert len(configuration) == int.from_bytes(configuration[2:4], "little") == 9 + 9 + 9 + 7 + 7
    assert host.control(0x81, 6, 0x2200) == (0, descriptor())
    assert host.control(0x80, 6, 0x0303) == (0, bytes([18, 3]) + "OGM-0001".encode("utf-16-le"))
    assert host.control(0x80, 6, 0x0309) == (rig_usbip.STALLED, b"")


def test_features_over_the_control_pipe(host: Host) -> None:
    status, answer = host.control(0xA1, 1, 0x0300 | ReportId.STATUS, REPORT)
    assert status == 0
    assert Report.unpack(answer).id == ReportId.STATUS
    assert host.control(0xA1, 1, 0x0355, REPORT)[0] == rig_usbip.STALLED
    config = host.rig.get_feature(ReportId.CONFIG)
    assert config is not None
    assert host.control(0x21, 9, 0x0300 | ReportId.CONFIG, data=config)[0] == 0
    assert host.control(0x21, 9, 0x0300 | ReportId.CONFIG, data=bytes(REPORT))[0] == rig_usbip.STALLED


def test_a_command_and_its_reply(host: Host) -> None:
    waiting = host.submit(1, 1, REPORT)
    command = Report(ReportId.COMMAND, 1, Opcode.NOP).pack()
    sent = host.submit(1, 0, REPORT, data=command)
    host.reads = False
    assert host.answer()[:2] == (sent, 0)
    host.link.send(host.rig.outbox.popleft())
    host.reads = True
    number, status, reply = host.answer()
    assert (number, status) == (waiting, 0)
    assert Report.unpack(reply).code == Status.OK


def test_a_stall_and_a_muted_feature(host: Host) -> None:
    host.rig.refusing = True
    host.submit(1, 0, REPORT, data=bytes(REPORT))
    assert host.answer()[1] == rig_usbip.STALLED
    assert not host.rig.outbox
    host.rig.muted = True
    held = host.submit(0, 1, REPORT, struct.pack("<BBHHH", 0xA1, 1, 0x0300 | ReportId.STATUS, 0, REPORT))
    host.socket.sendall(struct.pack(">IIIII", 2, 99, 0, 0, 0) + struct.pack(">I24x", held))
    host.link.serve()
    assert host.answer()[:2] == (99, rig_usbip.UNLINKED)
