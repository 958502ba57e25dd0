"""What the config says of the devices, and what a person is asked for."""

from pathlib import Path
from typing import Any

import pytest

from kinran.base.files import InputError
from kinran.capture import rig_devices
from kinran.capture.light_dose import Lighting
from kinran.capture.rig_devices import put, rig_config


def test_a_config_of_devices() -> None:
    config = rig_config({"camera": "ptpip:eos:1", "iso": 100, "speeds": [10, None], "lux": 5, "dose_limit_lux_h": 2})
    assert config.device == {"device": "hid", "iso": 100}
    assert config.lighting == Lighting(5, 2)
    assert config.speeds == (10, None)
    assert rig_config({}).camera == "usb"


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ({"cammera": "usb"}, "'cammera' is not known; it takes camera, iso"),
        ({"iso": "100"}, "--rig: is not the devices of a config .iso"),
        ({"dose_limit_lux_h": 5}, "needs rig.lux"),
    ],
)
def test_a_wrong_config(value: dict[str, Any], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        rig_config(value)


def test_a_person_is_asked_for_what_is_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups of one fabric follow each other without a question; another fabric is asked for."""
    monkeypatch.setattr(rig_devices, "ON_THE_RIG", tmp_path / "on-the-rig.json")
    asked: list[str] = []
    for wanted in ("silk/fabric", "silk/fabric", "silk/dark", "silk/fabric", "gold/fabric", "silk/fabric"):
        fabric, subject = wanted.split("/")
        put(tmp_path / fabric, asked.append, subject)
    words = ["silk", "cap", "silk", "gold", "silk"]
    assert [word in text for word, text in zip(words, asked, strict=True)] == [True] * 5


def test_a_question_without_an_answer_is_asked_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who is stopped while a subject is changed does not know what lies there."""
    monkeypatch.setattr(rig_devices, "ON_THE_RIG", tmp_path / "on-the-rig.json")
    asked: list[str] = []

    def leave(_: str) -> None:
        raise KeyboardInterrupt

    put(tmp_path, asked.append, "fabric")
    with pytest.raises(KeyboardInterrupt):
        put(tmp_path, leave, "dark")
    put(tmp_path, asked.append, "fabric")
    assert len(asked) == 2
