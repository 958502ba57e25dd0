"""A frame on trial: it comes whole, is said to be what it is, and no file is lost."""

import sys
from pathlib import Path

import pytest

from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.capture.trial_shot import _below, trial_shot
from kinran.rig.camera import CameraError

sys.path.insert(0, str(ROOT / "tests" / "fault"))
from capture_bench import Bench


def test_a_frame_comes_and_the_shutter_closes(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "rig")
    said = trial_shot(bench.devices(), 0.004, tmp_path)
    (name,) = bench.camera.fired
    assert (tmp_path / name).stat().st_size == 400
    assert f"{name}: 0.004 s" in said
    assert "the lamp is off" in said
    assert bench.camera.card() == []
    assert not bench.firmware.shutter_open
    (tmp_path / "IMG_00002.raw").write_bytes(b"another")
    with pytest.raises(InputError, match="is there already"):
        trial_shot(bench.devices(), 0.004, tmp_path)
    assert len(bench.camera.card()) == 1
    assert (tmp_path / "IMG_00002.raw").read_bytes() == b"another"


def test_no_frame_is_said(tmp_path: Path) -> None:
    bench = Bench(tmp_path / "rig")
    bench.camera.misbehave = ["miss", "miss"]
    with pytest.raises(CameraError, match="missed an exposure"):
        trial_shot(bench.devices(), 0.004, tmp_path)
    assert not bench.firmware.shutter_open


def test_brightest_hundredth() -> None:
    assert _below((*[0.0] * 20, 0.5, 0.48, 0.015, 0.005)) == 0.5
    assert _below((*[0.0] * 23, 1.0)) == 0.0
    assert _below((*[0.0] * 24,)) == 12.0
