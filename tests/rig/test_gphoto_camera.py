"""The camera behind libgphoto2, with an emulated EOS."""

import hashlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eos_emulator import Control, emulator, seen

from kinran.rig import gphoto_camera
from kinran.rig.camera import CameraError
from kinran.rig.gphoto_camera import CameraSettings, GphotoCamera, nearest, number, reset_usb

pytest.importorskip("gphoto2", reason="the camera's package has no wheel here")

SPEEDS = ["30", "1", "0.3", "1/4", "1/25", "1/100", "1/4000", "bulb"]


@pytest.fixture
def eos() -> Iterator[Control]:
    """An EOS with an empty card."""
    with emulator() as control:
        yield control


@pytest.fixture
def camera(eos: Control) -> Iterator[GphotoCamera]:
    """The camera, closed at the end."""
    opened = GphotoCamera(CameraSettings(eos.port), lands_s=1.0, busy_s=3.0)
    yield opened
    opened.close()


def process(camera: GphotoCamera) -> int:
    assert camera._process is not None
    return camera._process.pid


def test_a_frame_from_release_to_deletion(eos: Control, camera: GphotoCamera, tmp_path: Path) -> None:
    """Also: what the camera says of itself, and that no reading comes from libgphoto2's memory."""
    eos.tell(quality="raw+jpeg", scene="tile")
    assert camera.card() == []
    assert (camera.iso, camera.aperture) == (100, 5.6)
    health = camera.health()
    assert (health.battery, health.low, health.free_bytes) == ("100%", False, 16 << 30)
    camera.expose(1 / 250)
    (file,) = camera.card()
    path = tmp_path / "frame.part"
    camera.download(file.name, path)
    assert path.stat().st_size == file.bytes
    assert eos.tell()["readings"] == 1
    assert camera.digest(file.name) == hashlib.sha256(path.read_bytes()).hexdigest()
    assert eos.tell(readings=["flip"])["readings"] == 2
    assert camera.digest(file.name) != hashlib.sha256(path.read_bytes()).hexdigest()
    facts = camera.facts(path)
    assert (facts.exposure_s, facts.iso, facts.aperture) == pytest.approx((0.004, 100, 5.6))
    assert seen(path) == {"number": 0, "exposure": 0.004, "scene": "tile"}
    assert eos.tell()["card"] == ["IMG_0001.CR2", "IMG_0001.JPG"]
    camera.delete(file.name)
    assert eos.tell()["card"] == []
    assert camera.restarts == 0


def test_frames_are_listed_in_the_camera_s_order(eos: Control, camera: GphotoCamera) -> None:
    eos.tell(number=9998)
    for _ in range(3):
        eos.tell(release=True)
    assert [Path(file.name).name for file in camera.card()] == ["IMG_9999.CR2", "IMG_0001.CR2", "IMG_0002.CR2"]


@pytest.mark.parametrize("harm", ["killed", "hangs"])
def test_libgphoto2_is_started_anew(
    eos: Control, camera: GphotoCamera, harm: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A listing is asked for again; what was released is decided by the card."""
    eos.tell(release=True)
    first = camera.card()
    old = process(camera)
    if harm == "killed":
        os.kill(old, signal.SIGKILL)
    else:
        monkeypatch.setattr(gphoto_camera, "REQUEST_S", -2.0)
        os.kill(old, signal.SIGSTOP)
        with pytest.raises(CameraError, match="did not answer for 1 s"):
            camera._request("health", 1.0)
        monkeypatch.undo()
    assert camera.card() == first
    assert process(camera) != old
    assert camera.restarts == 1
    assert not Path(f"/proc/{old}").exists()


def test_nothing_is_left_behind(eos: Control, camera: GphotoCamera) -> None:
    """The process has a session of its own, a home of its own, and ends with both."""
    camera.card()
    assert camera._home is not None
    home, worker = Path(camera._home.name), process(camera)
    assert os.getsid(worker) == worker != os.getsid(0)
    camera.close()
    assert not home.exists()
    assert not Path(f"/proc/{worker}").exists()
    camera.close()


def test_a_process_whose_host_dies_ends(eos: Control, camera: GphotoCamera) -> None:
    """It lets go of the camera: its end of the socket is closed."""
    camera.card()
    assert camera._link is not None
    assert camera._process is not None
    camera._link.close()
    assert camera._process.wait(20) == 0
    camera._link = None


@pytest.mark.parametrize(
    ("settings", "state", "sentence"),
    [
        ({"iso": 160}, {}, r"rig.iso: 160 is not among .*100, 200, 400"),
        ({"aperture": 4}, {}, r"rig.aperture: 4 is not among .*5.6, 8"),
        ({}, {"quality": "jpeg"}, "writes no RAW files"),
        ({}, {"mode": 0}, "in mode P"),
    ],
    ids=["iso", "aperture", "jpeg", "mode"],
)
def test_a_camera_that_cannot_do_it(eos: Control, settings: Any, state: Any, sentence: str) -> None:
    eos.tell(**state)
    camera = GphotoCamera(CameraSettings(eos.port, **settings))
    with pytest.raises(CameraError, match=sentence):
        camera.card()
    assert camera._process is None


def test_no_camera() -> None:
    camera = GphotoCamera(CameraSettings("usb"))
    with pytest.raises(CameraError, match="no camera is connected"):
        camera.card()


@pytest.mark.parametrize("port", ["", "usb:1", "ptpip", "ptpip:a b", "serial:/dev/ttyS0"])
def test_wrong_ports(port: str) -> None:
    with pytest.raises(CameraError, match="is no port of a camera"):
        GphotoCamera(CameraSettings(port))


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gphoto_camera, "find_spec", lambda name: None)
    with pytest.raises(CameraError, match="pip install 'gphoto2"):
        GphotoCamera(CameraSettings("usb")).card()


@pytest.mark.parametrize(("seconds", "name"), [(0.04, "1/25"), (0.3, "0.3"), (1 / 4, "1/4"), (1.0, "1"), (29.9, "30")])
def test_exposure_times_have_names(seconds: float, name: str) -> None:
    assert nearest(SPEEDS, seconds) == name


def test_an_exposure_time_that_the_camera_lacks() -> None:
    with pytest.raises(CameraError, match=r"no exposure time of 0.002 s; it has 30, 1, 0.3"):
        nearest(SPEEDS, 1 / 500)


@pytest.mark.parametrize(("text", "value"), [("f/5.6", 5.6), ("1/250", 0.004), ("Auto", None), ("0", None), ("", None)])
def test_numbers_in_names(text: str, value: float | None) -> None:
    assert number(text) == value


def test_a_reset_touches_nothing_but_usb(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Path] = []

    def refuse(path: Path, mode: str) -> None:
        opened.append(path)
        raise PermissionError

    monkeypatch.setattr(Path, "open", refuse)
    reset_usb("ptpip:127.0.0.1:15740")
    reset_usb("usb:001,004")
    assert opened == [Path("/dev/bus/usb/001/004")]
