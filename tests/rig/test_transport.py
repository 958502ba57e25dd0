"""HID handles: opening the real one through hidapi, and the habits of the simulated one."""

import os
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from kinran.rig import transport
from kinran.rig.firmware import Firmware
from kinran.rig.protocol import Opcode, Report, ReportId
from kinran.rig.transport import SimulatedHid, TransportError, hid_module, open_hid, rig_lock

NOP = Report(ReportId.COMMAND, 1, Opcode.NOP).pack()


class Device:
    """What hidapi's ``device`` does on opening."""

    denied = False

    def open_path(self, path: bytes) -> None:
        if self.denied:
            raise OSError("open failed")
        self.path = path


@pytest.fixture
def hidapi(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A stand-in for hidapi with a list of connected rigs."""
    connected: list[dict[str, Any]] = []
    module: Any = types.ModuleType("hidraw")
    module.device = Device
    module.version_str = lambda: "0.15.0"
    module.enumerate = lambda vendor, product: [
        info for info in connected if (info["vendor_id"], info["product_id"]) == (vendor, product)
    ]
    monkeypatch.setitem(sys.modules, "hidraw", module)
    monkeypatch.setattr(Device, "denied", False)
    return connected


def rig(serial: str) -> dict[str, Any]:
    path = f"/dev/hid-{serial}".encode()
    return {"vendor_id": 0x1209, "product_id": 1, "serial_number": serial, "path": path}


def test_the_only_rig_is_opened(hidapi: list[dict[str, Any]]) -> None:
    hidapi.append(rig("OGM-1"))
    assert open_hid().serial == "OGM-1"
    assert open_hid("OGM-1").serial == "OGM-1"


def test_no_rig_or_another(hidapi: list[dict[str, Any]]) -> None:
    with pytest.raises(TransportError, match=r"1209:0001.*cable"):
        open_hid()
    hidapi.append(rig("OGM-1"))
    with pytest.raises(TransportError, match=r"OGM-2.*OGM-1"):
        open_hid("OGM-2")
    with pytest.raises(TransportError, match="abcd:0001"):
        open_hid(vendor=0xABCD)


def test_several_rigs_need_a_serial_number(hidapi: list[dict[str, Any]]) -> None:
    hidapi.extend([rig("OGM-1"), rig("OGM-2")])
    with pytest.raises(TransportError, match="--serial"):
        open_hid()
    assert open_hid("OGM-2").serial == "OGM-2"


def test_no_permission_says_how_to_get_it(hidapi: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    hidapi.append(rig("OGM-1"))
    monkeypatch.setattr(Device, "denied", True)
    with pytest.raises(TransportError, match="install-udev"):
        open_hid()


def test_a_rig_that_libusb_may_not_open_has_no_serial_number(hidapi: list[dict[str, Any]]) -> None:
    hidapi.append(rig(""))
    with pytest.raises(TransportError, match="install-udev"):
        open_hid("OGM-1")


def test_another_packages_hid_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """PyPI's ``hid`` has ``Device`` and no ``device``."""
    other: Any = types.ModuleType("hid")
    other.Device = object
    monkeypatch.setitem(sys.modules, "hidraw", None)
    monkeypatch.setitem(sys.modules, "hid", other)
    with pytest.raises(TransportError, match="pip uninstall hid"):
        hid_module()


def test_the_installed_module_is_hidapis() -> None:
    pytest.importorskip("hidraw", exc_type=ImportError)
    assert hid_module().version_str()


def test_two_programs_of_any_user_or_setting(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(transport, "NODES", f"{tmp_path}/".encode())
    node, other = tmp_path / "hidraw0", tmp_path / "hidraw1"
    node.touch()
    other.touch()
    with rig_lock(bytes(node), "OGM-1"):
        monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
        message = f"another program .*process {os.getpid()}"
        with pytest.raises(TransportError, match=message), rig_lock(bytes(node), "OGM-1"):
            pass
        with rig_lock(bytes(other), "OGM-2"):
            pass
    with rig_lock(bytes(node), "OGM-1"):
        pass


def test_a_rig_that_is_unplugged_before_it_is_locked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(transport, "NODES", f"{tmp_path}/".encode())
    with pytest.raises(TransportError, match="disconnected"), rig_lock(bytes(tmp_path / "hidraw0"), "OGM-1"):
        pass


@pytest.mark.parametrize("backend", ["hidraw", "libusb"])
def test_habits_of_both_back_ends(backend: Any) -> None:
    firmware = Firmware()
    handle = SimulatedHid(firmware, backend)
    assert handle.write(NOP) == 64
    reply = handle.read(64, 20)
    assert reply[:1] == [ReportId.REPLY]
    before = firmware.clock
    assert handle.read(64, 20) == []
    assert firmware.clock == pytest.approx(before + 0.02)
    with pytest.raises(RuntimeError, match="blocks"):
        handle.read(64)
    assert handle.write(b"") == -1
    assert handle.write(b"\x01") == (-1 if backend == "hidraw" else 1)
    assert handle.send_feature_report(bytes(64)) == -1
    assert handle.get_feature_report(ReportId.STATUS, 64)[:1] == [ReportId.STATUS]
    with pytest.raises(OSError, match="feature"):
        handle.get_feature_report(0x55, 64)
    firmware.plugged = False
    assert handle.write(NOP) == -1
    with pytest.raises(OSError, match="read error"):
        handle.read(64, 20)
    handle.close()
    with pytest.raises(ValueError, match="not open"):
        handle.read(64, 20)


@pytest.mark.parametrize(("backend", "kept", "first"), [("hidraw", 63, 1), ("libusb", 32, 169)])
def test_unread_events_overflow(backend: Any, kept: int, first: int) -> None:
    """Of 200 unread events hidraw keeps the oldest 63, libusb the newest 32."""
    firmware = Firmware()
    handle = SimulatedHid(firmware, backend)
    firmware.advance(200.5)
    numbers: list[int] = []
    while len(numbers) < kept:
        report = Report.unpack(bytes(handle.read(64, 1)))
        numbers.append(int.from_bytes(report.payload[40:44], "little"))
    assert numbers == list(range(first, first + kept))
    assert handle.read(64, 1) == []
    assert handle.lost == 200 - kept
