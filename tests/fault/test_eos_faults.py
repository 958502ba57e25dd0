"""Captures with an emulated EOS that misbehaves, through the real libgphoto2: every frame is right, or a sentence."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eos_bench import EXPOSURES, EosBench, check_frames, kept_aside, short_plan
from eos_emulator import emulator

from kinran.capture.journal import read
from kinran.data.capture_plan import write_plan
from kinran.rig import gphoto_camera
from kinran.rig.camera import CameraError

pytestmark = pytest.mark.slow
CAMPAIGN = pytest.mark.campaign  # each waits for seconds for a camera that does not answer: `kinran test camera`
pytest.importorskip("gphoto2", reason="the camera's package has no wheel here")

PLAN = short_plan()
FRAMES = 2 * len(EXPOSURES)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[EosBench]:
    """A rig, and an EOS with an empty card."""
    with emulator() as eos:
        yield EosBench(tmp_path, eos)


def records(bench: EosBench, kind: str) -> list[dict[str, Any]]:
    return [record for record in read(bench.root / "journal.jsonl")[0] if record["t"] == kind]


@pytest.mark.parametrize(
    ("fault", "surplus"),
    [
        ({}, 0),
        pytest.param({"busy": 3, "hang": 0x9128}, 0, marks=CAMPAIGN),
        pytest.param({"hang": 0x101B}, 0, marks=CAMPAIGN),
        ({"readings": ["", "", "cut", "", "flip", "", "drop"]}, 0),
        pytest.param({"partial": False, "readings": ["", "cut"]}, 0, marks=CAMPAIGN),
        pytest.param({"exposures": ["twice", "wrong", "", "miss"], "battery": 0}, 1, marks=CAMPAIGN),
        pytest.param({"exposures": ["", "foreign"]}, 2, marks=CAMPAIGN),
        ({"exposures": ["", "late 1"]}, 2),
        pytest.param({"exposures": ["late 3"]}, 1, marks=CAMPAIGN),
        ({"number": 9997, "quality": "raw+jpeg"}, 0),
    ],
    ids=str,
)
def test_every_frame_is_right(
    bench: EosBench, fault: dict[str, Any], surplus: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All exposures that the camera took are recorded, or put aside; the card is empty."""
    monkeypatch.setattr(gphoto_camera, "REQUEST_S", 6.0)
    bench.eos.tell(**fault)
    numbers = check_frames(bench.root, PLAN, bench.capture(PLAN))
    taken = bench.eos.tell()
    assert taken["card"] == []
    assert sorted([*numbers, *kept_aside(bench.root)]) == list(range(taken["fired"]))
    assert taken["fired"] == FRAMES + surplus
    assert not bench.firmware.shutter_open


@pytest.mark.parametrize(
    ("fault", "mended", "sentence"),
    [
        pytest.param({"busy": -1}, {"busy": 0}, "stays busy; switch it off", marks=CAMPAIGN),
        pytest.param({"quality": "jpeg"}, {"quality": "raw"}, "set its image quality to RAW", marks=CAMPAIGN),
        pytest.param({"exposures": ["", "", "miss", "miss"]}, {}, "missed an exposure of 0.04 s twice", marks=CAMPAIGN),
        pytest.param(
            {"exposures": ["", "wrong", "wrong"]}, {}, r"its exposure is 1/250 s|check its settings", marks=CAMPAIGN
        ),
        pytest.param(
            {"readings": ["cut"] * 3},
            {},
            r"2\d\d\d of .* bytes came|bytes came; it is still on the card",
            marks=CAMPAIGN,
        ),
        ({"readings": ["flip"] + ["", "flip"] * 3}, {}, "two readings of it differ"),
    ],
    ids=str,
)
def test_what_does_not_mend_itself_is_a_sentence(
    bench: EosBench, fault: dict[str, Any], mended: dict[str, Any], sentence: str
) -> None:
    """The capture stops, nothing is lost, and it goes on when the cause is gone."""
    bench.eos.tell(**fault)
    with pytest.raises(CameraError, match=sentence):
        bench.capture(PLAN)
    assert not bench.firmware.shutter_open
    before = bench.eos.tell()
    numbers = [record["name"] for record in records(bench, "frame")]
    assert before["fired"] == len(numbers) + len(kept_aside(bench.root)) + len(before["card"])
    bench.eos.tell(**mended)
    check_frames(bench.root, PLAN, bench.capture(PLAN))
    assert bench.eos.tell()["card"] == []


@pytest.mark.parametrize("number", [pytest.param(0, marks=CAMPAIGN), 9998])
def test_a_bracket_of_a_dead_host_is_adopted_by_its_exif(bench: EosBench, number: int) -> None:
    """Names wrap from IMG_9999 to IMG_0001 in the bracket that was under way."""
    bench.eos.tell(number=number)
    real = gphoto_camera.GphotoCamera.download

    def die(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(gphoto_camera.GphotoCamera, "download", die)
        with pytest.raises(KeyboardInterrupt):
            bench.capture(PLAN)
    assert gphoto_camera.GphotoCamera.download is real
    assert len(bench.eos.tell()["card"]) == len(EXPOSURES)
    assert sorted(check_frames(bench.root, PLAN, bench.capture(PLAN))) == list(range(FRAMES))
    assert sum(record["how"] == "adopted" for record in records(bench, "frame")) == len(EXPOSURES)


def test_settings_that_are_asked_for_are_set(bench: EosBench) -> None:
    bench.settings = gphoto_camera.CameraSettings(bench.eos.port, iso=400, aperture=8)
    check_frames(bench.root, PLAN, bench.capture(PLAN))
    facts = gphoto_camera.raw_facts(bench.root / records(bench, "frame")[0]["file"])
    assert facts.iso == 400
    assert facts.aperture == pytest.approx(8)


def test_ctrl_c(tmp_path: Path) -> None:
    """The shutter is closed, libgphoto2's process ended, and the capture can go on."""
    write_plan(tmp_path / "plan.json", short_plan(4))
    with emulator() as eos:
        camera_port, control_port = eos.port.rpartition(":")[2], eos.control
        words = ["capture", "--plan", str(tmp_path / "plan.json"), "--group", "00", "--device", "hid"]
        words += ["--rig", json.dumps({"camera": eos.port}), str(tmp_path / "00.json")]
        script = str(Path(__file__).with_name("eos_bench.py"))
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        command = [sys.executable, script, camera_port, str(control_port), *words]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment
        ) as process:
            until = time.monotonic() + 60
            while eos.tell()["fired"] < 3 and time.monotonic() < until:
                time.sleep(0.05)
            assert eos.tell()["fired"] >= 3
            workers = children(process.pid)
            os.killpg(process.pid, signal.SIGINT)
            out, errors = process.communicate(timeout=60)
        assert process.returncode == 130, errors
        assert "shutter closed" in out
        assert "kinran capture: stopped" in errors
        assert len(workers) == 1
        assert not any(Path(f"/proc/{worker}").exists() for worker in workers)
        assert subprocess.run(command, stdout=subprocess.DEVNULL, env=environment, timeout=120).returncode == 0
        manifest = json.loads((tmp_path / "00.json").read_text())
        check_frames(tmp_path, short_plan(4), manifest)
        assert eos.tell()["card"] == []


def children(process: int) -> list[int]:
    """Processes that a process has started."""
    return [int(word) for word in Path(f"/proc/{process}/task/{process}/children").read_text().split()]
