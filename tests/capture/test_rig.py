"""`kinran rig` on the command line."""

import re
import sys
import types
from typing import Any

import pytest

from kinran.__main__ import main


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
