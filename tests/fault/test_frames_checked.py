"""Frames are checked before their originals go, and find their exposures by what they say of themselves."""

import errno
import json
import os
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from capture_bench import EXPOSURES, Bench, check, small_plan

from kinran.base.files import InputError
from kinran.capture.journal import read
from kinran.capture.light_dose import Lighting, light_dose
from kinran.rig.camera import CameraError, Health
from kinran.rig.errors import LimitError
from kinran.rig.goniometer import Goniometer

PLAN = small_plan()
FRAMES = 16 * len(EXPOSURES)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A rig and a camera with an empty card."""
    return Bench(tmp_path)


def records(bench: Bench, kind: str) -> list[dict[str, Any]]:
    return [record for record in read(bench.root / "journal.jsonl")[0] if record["t"] == kind]


def aside(bench: Bench) -> list[int]:
    """Numbers of the exposures in the quarantine."""
    return [json.loads(path.read_bytes())["number"] for path in (bench.root / "quarantine").glob("*")]


def whole(bench: Bench, manifest: dict[str, Any]) -> None:
    """Every exposure is recorded under its own shot or put aside, and the card is empty."""
    numbers = check(bench.root, PLAN, manifest)
    assert sorted([*numbers, *aside(bench)]) == list(range(len(bench.camera.fired)))
    assert bench.camera.card() == []


def die_at(bench: Bench, call: str) -> None:
    """Capture with a host that dies at its first call of the camera's download, or of another method."""

    def die(*_: Any) -> None:
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.camera, call, die)
        with pytest.raises(KeyboardInterrupt):
            bench.capture(PLAN)


def harm(data: bytes, how: str) -> bytes:
    return data[:200] if how == "truncated" else data[:50] + b"\0\0\0" + data[53:]


@pytest.mark.parametrize("how", ["truncated", "changed"])
@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_bad_download_is_fetched_again(bench: Bench, how: str, times: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three bad ones stop the capture; the frame is still on the card, and is adopted by the next session."""
    real, bad = bench.camera.download, ["", "", "", "", *times * [how]]

    def download(name: str, to: Path) -> None:
        real(name, to)
        if bad and (fault := bad.pop(0)):
            to.write_bytes(harm(to.read_bytes(), fault))

    monkeypatch.setattr(bench.camera, "download", download)
    if times == 3:
        message = "200 of 400 bytes" if how == "truncated" else "two readings of it differ"
        with pytest.raises(CameraError, match=message):
            bench.capture(PLAN)
        assert len(bench.camera.card()) == len(EXPOSURES)
        assert not bench.firmware.shutter_open
    whole(bench, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


def test_a_second_reading_that_is_bad_is_repeated(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    real, bad = bench.camera.digest, ["", "0" * 64]
    monkeypatch.setattr(bench.camera, "digest", lambda name: (bad.pop(0) if bad else "") or real(name))
    whole(bench, bench.capture(PLAN))
    assert bad == []


def test_a_frame_that_is_damaged_on_the_card_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its readings agree, but it does not decode; the next session puts it aside and takes the bracket again."""
    real = bench.camera.land
    monkeypatch.setattr(bench.camera, "land", lambda name, data: real(name, data[:300] if "00005" in name else data))
    with pytest.raises(CameraError, match=r"IMG_00005.raw is damaged on the card: it is cut off"):
        bench.capture(PLAN)
    assert len(bench.camera.card()) == 3
    check(bench.root, PLAN, bench.capture(PLAN))
    assert bench.camera.card() == []
    assert len(bench.camera.fired) == FRAMES + 3
    assert len(list((bench.root / "quarantine").iterdir())) == 3


@pytest.mark.parametrize("wrong", [{"exposure": 1 / 32_000}, {"iso": 400.0}])
def test_a_frame_with_other_settings_is_taken_again(
    bench: Bench, wrong: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """That one frame alone: the others of its bracket are good."""
    real = bench.camera.land

    def land(name: str, data: bytes) -> None:
        said = json.loads(data) | (wrong if len(bench.camera.fired) == 8 else {})
        real(name, json.dumps(said).encode().ljust(400))

    monkeypatch.setattr(bench.camera, "land", land)
    whole(bench, bench.capture(PLAN))
    assert aside(bench) == [7]
    assert len(bench.camera.fired) == FRAMES + 1


def test_a_camera_that_never_does_as_asked_stops(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.camera, "iso", 200.0)
    with pytest.raises(CameraError, match=r"ISO is 100 instead of 200.*check its settings"):
        bench.capture(PLAN)
    assert records(bench, "frame") == []


def wrap(bench: Bench, monkeypatch: pytest.MonkeyPatch, first: int = 9998) -> None:
    """Give frames names as Canon does: IMG_9999 is followed by IMG_0001."""
    real = bench.camera.land

    def land(name: str, data: bytes) -> None:
        real(f"IMG_{(first + int(name[4:9]) - 2) % 9999 + 1:04d}.raw", data)

    monkeypatch.setattr(bench.camera, "land", land)


@pytest.mark.parametrize("killed", [False, True])
def test_names_that_wrap(bench: Bench, killed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the names decide which frame is whose, in a session and after its death."""
    wrap(bench, monkeypatch)
    if killed:
        die_at(bench, "download")
        assert [file.name for file in bench.camera.card()] == ["IMG_9998.raw", "IMG_9999.raw", "IMG_0001.raw"]
    whole(bench, bench.capture(PLAN))
    assert sum(record["how"] == "adopted" for record in records(bench, "frame")) == 3 * killed


def test_adoption_trusts_no_order(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A camera that lists its card in another order changes nothing."""
    die_at(bench, "download")
    real = bench.camera.card
    monkeypatch.setattr(bench.camera, "card", lambda: real()[::-1])
    whole(bench, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


def test_a_formatted_card_on_which_names_come_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The counter is set back; a recorded name comes again and is another frame."""
    bench.capture(PLAN)
    wrap(bench, monkeypatch, first=10_000 - FRAMES)
    manifest = bench.capture(PLAN, revisions={"t30_p045": 1})
    check(bench.root, PLAN, manifest)
    assert bench.camera.card() == []
    names = [record["name"] for record in records(bench, "frame")]
    assert len(bench.camera.fired) == FRAMES + 3
    assert len(names) == FRAMES + 3


@pytest.mark.parametrize("brackets", [0, 1, 2])
@pytest.mark.parametrize("counted", [True, False])
def test_a_frame_that_lands_late(bench: Bench, brackets: int, counted: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """It lands with the retry of its exposure, in the next bracket, or in the one after: never under another shot."""
    bench.firmware.capabilities = int(counted)
    land, expose = bench.camera.land, bench.camera.expose
    late: list[tuple[str, bytes]] = []
    fired = 7

    def landing(name: str, data: bytes) -> None:
        if len(bench.camera.fired) == fired + 1 and not late:
            late.append((name, data))
        else:
            land(name, data)

    def exposing(seconds: float) -> None:
        count = len(bench.camera.fired)
        expose(seconds)
        if count == fired:
            if counted:
                bench.firmware.sync()
            raise CameraError("no file event in time")
        if late and count == fired + 1 + len(EXPOSURES) * brackets:
            land(*late[0])

    monkeypatch.setattr(bench.camera, "land", landing)
    monkeypatch.setattr(bench.camera, "expose", exposing)
    whole(bench, bench.capture(PLAN))
    assert len(bench.camera.fired) <= FRAMES + 3


def test_a_late_frame_whose_own_exposure_is_missed(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The one frame that lands in the next bracket has the right exposure, and is of the bracket before."""
    land, expose = bench.camera.land, bench.camera.expose
    late: list[tuple[str, bytes]] = []

    def landing(name: str, data: bytes) -> None:
        late.append((name, data)) if len(bench.camera.fired) == 1 else land(name, data)

    def exposing(seconds: float) -> None:
        if len(bench.camera.fired) == 4 and late:
            land(*late.pop())
            return
        expose(seconds)
        if len(bench.camera.fired) == 1:
            raise CameraError("no file event in time")

    monkeypatch.setattr(bench.camera, "land", landing)
    monkeypatch.setattr(bench.camera, "expose", exposing)
    whole(bench, bench.capture(PLAN))
    assert aside(bench) == [0]


def test_a_late_frame_is_not_adopted_by_the_bracket_after_its_own(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The host dies in the second bracket, on whose card only a late frame of the first has landed."""
    bench.firmware.capabilities = 0
    land, expose = bench.camera.land, bench.camera.expose
    late: list[tuple[str, bytes]] = []

    def landing(name: str, data: bytes) -> None:
        late.append((name, data)) if len(bench.camera.fired) == 1 else land(name, data)

    def exposing(seconds: float) -> None:
        if len(bench.camera.fired) == 4:
            land(*late.pop())
            raise KeyboardInterrupt
        expose(seconds)
        if len(bench.camera.fired) == 1:
            raise CameraError("no file event in time")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench.camera, "land", landing)
        patch.setattr(bench.camera, "expose", exposing)
        with pytest.raises(KeyboardInterrupt):
            bench.capture(PLAN)
    whole(bench, bench.capture(PLAN))
    assert aside(bench) == [0]


def test_a_frame_that_is_a_little_late_is_waited_for(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rig has counted its exposure, so that it is not taken twice."""
    land, expose, card = bench.camera.land, bench.camera.expose, bench.camera.card
    late: list[tuple[str, bytes]] = []
    looks = [0]

    def landing(name: str, data: bytes) -> None:
        late.append((name, data)) if len(bench.camera.fired) == 8 else land(name, data)

    def listing() -> Any:
        looks[0] += bool(late)
        if looks[0] == 5 and late:
            land(*late.pop())
        return card()

    monkeypatch.setattr(bench.camera, "land", landing)
    monkeypatch.setattr(bench.camera, "expose", expose)
    monkeypatch.setattr(bench.camera, "card", listing)
    whole(bench, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


def test_a_shutter_that_somebody_releases_between_brackets(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The frame is put aside, and the brackets before and after are good."""
    move = bench.firmware._move

    def moving(*args: Any) -> Any:
        if len(bench.camera.fired) == 9:
            bench.camera.expose(EXPOSURES[0])
        return move(*args)

    monkeypatch.setattr(bench.firmware, "_move", moving)
    whole(bench, bench.capture(PLAN))
    assert aside(bench) == [9]
    assert len(bench.camera.fired) == FRAMES + 1


@pytest.mark.parametrize("error", [errno.EIO, errno.EROFS, errno.ENOSPC, errno.EDQUOT])
@pytest.mark.parametrize("where", ["download", "replace", "journal"])
def test_a_disk_that_fails(bench: Bench, error: int, where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A sentence; the frames stay on the card, and are adopted when the disk is back."""

    def fail(*_: Any) -> None:
        raise OSError(error, os.strerror(error))

    fault = {"download": (bench.camera, "download"), "replace": (Path, "replace"), "journal": (os, "fsync")}[where]
    expose = bench.camera.expose

    def exposing(seconds: float) -> None:
        expose(seconds)
        if len(bench.camera.fired) == 6:
            monkeypatch.setattr(*fault, fail)

    monkeypatch.setattr(bench.camera, "expose", exposing)
    with pytest.raises(InputError, match="disk"):
        bench.capture(PLAN)
    assert len(bench.camera.card()) == len(EXPOSURES)
    assert not bench.firmware.shutter_open
    monkeypatch.undo()
    whole(bench, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


def test_a_rig_without_a_photodiode(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is never asked for its light, and the lamp is judged by nothing."""
    opened = bench.devices

    class Blind:
        def __init__(self, rig: Goniometer) -> None:
            self._rig = rig

        def __getattr__(self, name: str) -> Any:
            if name == "identity":
                return replace(self._rig.identity, photodiode=False)
            assert name != "intensity"
            return getattr(self._rig, name)

    @contextmanager
    def devices() -> Any:
        with opened() as (rig, camera):
            yield Blind(rig), camera

    manifest = bench.capture(PLAN, devices=devices)
    check(bench.root, PLAN, manifest)
    assert {shot["photodiode"] for shot in manifest["shots"]} == {0}


def test_the_light_dose_is_kept_and_limited(bench: Bench) -> None:
    """The sum counts every bracket; the capture ends before the one that would be too much."""
    with pytest.raises(InputError, match=r"rig.dose_limit_lux_h: the sample has had 0.763 lux hours.* of at most 1"):
        bench.capture(PLAN, lighting=Lighting(lux=300.0, limit_lux_h=1.0))
    dose = light_dose(read(bench.root / "journal.jsonl")[0])
    shots = len(records(bench, "frame")) // len(EXPOSURES)
    assert dose.open_s == pytest.approx(shots * (sum(EXPOSURES) + len(EXPOSURES)), abs=0.01 * shots)
    assert dose.lux_h == pytest.approx(300 * dose.open_s / 3600, rel=1e-3)
    assert dose.lux_h <= 1
    bench.capture(PLAN)
    after = light_dose(read(bench.root / "journal.jsonl")[0])
    assert after.open_s == pytest.approx(16 / shots * dose.open_s, rel=0.01)
    assert after.lux_s == pytest.approx(dose.lux_s)


def test_a_bracket_of_a_dead_host_counts_in_the_dose(bench: Bench) -> None:
    """Nobody knows how long its shutter was open: it counts as the longest."""
    die_at(bench, "expose")
    dose = light_dose(read(bench.root / "journal.jsonl")[0])
    assert dose.open_s == pytest.approx(sum(EXPOSURES) + len(EXPOSURES) + 2)


def test_dark_white_and_chart_are_no_dose_of_the_sample(bench: Bench) -> None:
    bench.capture(PLAN, "calibration")
    fabric = [r for r in records(bench, "intent") if r["subject"] == "fabric"]
    dose = light_dose(read(bench.root / "journal.jsonl")[0])
    assert dose.open_s == pytest.approx(len(fabric) * (sum(EXPOSURES) + len(EXPOSURES)), rel=0.01)
    assert len(fabric) == 4


def test_the_way_is_checked_before_the_lamp_is_lit(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two poses that are good, with a camera arm between them."""
    first = PLAN.groups[0]
    aside_ = replace(first.shots[1], theta=80.0, phi=0.0, camera=(75.0, 180.0))
    through = replace(first.shots[2], theta=80.0, phi=359.0, camera=(75.0, 180.0))
    plan = replace(PLAN, groups=(replace(first, shots=(aside_, through)), *PLAN.groups[1:]))
    with pytest.raises(LimitError, match="on the way"):
        bench.capture(plan)
    assert not bench.firmware.lamp_on


def test_a_resume_goes_the_quick_way(bench: Bench) -> None:
    """What is missing is not shot in the plan's order, but from where the arm stands."""
    bench.capture(PLAN)
    missing = ["t30_p000", "t30_p135", "t30_p270"]
    bench.firmware._start = (30_000.0, 270_000.0, 0.0, 0.0)
    bench.firmware._end = bench.firmware._start
    bench.capture(PLAN, revisions=dict.fromkeys(missing, 1))
    assert [record["shot"] for record in records(bench, "intent")][-3:] == missing[::-1]


def test_a_watcher_is_told(bench: Bench) -> None:
    """Lamp, progress, dose, camera and the last frame, as the live view shows them."""
    told: dict[str, list[Any]] = {}

    def tell(**changes: Any) -> None:
        for name, value in changes.items():
            told.setdefault(name, []).append(value)

    bench.capture(PLAN, tell=tell, lighting=Lighting(lux=300.0))
    assert told["done"] == list(range(1, 17))
    assert told["phase"][0] == "waits for the lamp"
    assert told["phase"][-1] == "shoots"
    assert told["lamp"][0] == "warms up"
    assert any("a minute" in words for words in told["lamp"])
    assert told["lamp"][-1] == "warm and steady"
    assert told["battery"] == ["75%", "75%"]
    assert told["card"][0] == "1.0 GB free"
    assert "lux hours" in told["dose"][-1]
    assert told["frame"][0] == ("frames/00/monitor_1_e0_r0.raw", EXPOSURES[0])


@pytest.mark.parametrize(("battery", "low"), [("25%", True), ("Low", True), ("50%", False), ("", False)])
def test_a_battery_that_is_nearly_empty(
    bench: Bench, battery: str, low: bool, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(bench.camera, "health", lambda: Health(battery))
    bench.capture(PLAN)
    assert ("battery is at" in caplog.text) == low
