"""`kinran rig` on the command line."""

import re
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest

from kinran.__main__ import main
from kinran.base.project import ROOT


def test_move_a_virtual_rig(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--device", "virtual", "move", "30", "45"]) == 0
    text = capsys.readouterr().out
    assert "OGM-VIRTUAL" in text
    assert re.search(r"light θ +(30\.00|29\.99)", text)
    assert "fault     none" in text


def test_status_and_home(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--device", "virtual", "status"]) == 0
    assert "not homed" in capsys.readouterr().out
    assert main(["rig", "--device", "virtual", "home"]) == 0
    assert "not homed" not in capsys.readouterr().out


def test_outside_the_limits(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--device", "virtual", "move", "95", "0"]) == 2
    assert "light θ = 95° is outside" in capsys.readouterr().err


def test_no_rig(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    module: Any = types.ModuleType("hidraw")
    module.device = module.version_str = object
    module.enumerate = lambda vendor, product: []
    monkeypatch.setitem(sys.modules, "hidraw", module)
    assert main(["rig", "--usb", "abcd:0002", "status"]) == 2
    assert "no rig (abcd:0002) is connected" in capsys.readouterr().err


@pytest.mark.parametrize("pair", ["1209", "xyz:1", "1:2:3"])
def test_wrong_pair(pair: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--usb", pair, "status"]) == 2
    assert f"'{pair}': is not VENDOR:PRODUCT" in capsys.readouterr().err


def test_jog_and_park(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--device", "virtual", "jog", "phi", "-2.5"]) == 0
    assert re.search(r"light φ +-2\.(50|49)", capsys.readouterr().out)
    assert main(["rig", "--device", "virtual", "jog", "camera-theta", "80"]) == 2
    assert "camera θ = 80" in capsys.readouterr().err
    assert main(["rig", "--device", "virtual", "park"]) == 0
    assert "lamp      off" in capsys.readouterr().out


def test_emergency_stop(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "--device", "virtual", "estop"]) == 0
    assert "emergency stop sent" in capsys.readouterr().out


def test_the_udev_rule_is_the_one_in_the_docs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["rig", "install-udev", "--to", str(tmp_path)]) == 0
    written = (tmp_path / "70-kinran-rig.rules").read_text().splitlines()
    assert "udevadm control --reload" in capsys.readouterr().out
    docs = (ROOT / "docs/rig.md").read_text().splitlines()
    assert [line for line in docs if line.startswith("SUBSYSTEM==")] == written[1:]
    assert main(["rig", "--usb", "0Ab0:CDEF", "install-udev", "--to", str(tmp_path)]) == 0
    text = (tmp_path / "70-kinran-rig.rules").read_text()
    assert 'KERNELS=="0003:0AB0:CDEF.*"' in text
    assert 'ATTRS{idVendor}=="0ab0", ATTRS{idProduct}=="cdef"' in text
    assert main(["rig", "install-udev", "--to", str(tmp_path / "no")]) == 2
    assert "run it as root" in capsys.readouterr().err


def test_the_rig_can_be_stopped_where_there_is_hidapi_alone() -> None:
    code = "import sys; sys.modules['numpy'] = None; import kinran.capture.rig"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
