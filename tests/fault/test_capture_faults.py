"""What goes wrong in a capture, and that it stops with one sentence and goes on from there."""

import errno
import json
import os
import shutil
from collections import namedtuple
from pathlib import Path
from typing import Any

import pytest
from capture_bench import DEVICE, EXPOSURES, Bench, check, small_plan

from kinran.__main__ import main
from kinran.base.files import InputError
from kinran.capture.grid import plan_grid
from kinran.capture.journal import Journal, read
from kinran.capture.lamp_watch import LampWatch
from kinran.data.capture_plan import write_plan
from kinran.rig.camera import CameraError
from kinran.rig.errors import DisconnectedError, FaultError, LimitError, RigError
from kinran.rig.protocol import Fault

PLAN = small_plan()
SHOTS = 16
FRAMES = SHOTS * len(EXPOSURES)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A rig and a camera with an empty card."""
    return Bench(tmp_path)


def kinds(root: Path) -> list[str]:
    return [record["t"] for record in read(root / "journal.jsonl")[0]]


def stop_after(bench: Bench, exposures: int, act: Any) -> None:
    """Do something to the rig in the middle of an exposure."""
    real = bench.camera.expose

    def expose(seconds: float) -> None:
        real(seconds)
        if len(bench.camera.fired) == exposures:
            act()

    bench.camera.expose = expose  # type: ignore[method-assign]


def test_all_goes_well(bench: Bench) -> None:
    manifest = bench.capture(PLAN)
    assert sorted(check(bench.root, PLAN, manifest)) == list(range(FRAMES))
    assert manifest["lights"] == list(range(9))
    assert [shot["light"] for shot in manifest["shots"]] == [*range(8), *[8] * 8]
    assert all(abs(shot["photodiode"] - 100_000) < 2000 for shot in manifest["shots"])
    assert bench.camera.card() == []
    assert bench.firmware.lamp_on
    assert not bench.firmware.shutter_open
    again = bench.capture(PLAN, devices=None)
    assert json.dumps(again) == json.dumps(manifest)
    assert len(bench.camera.fired) == FRAMES


def test_calibration_group(bench: Bench) -> None:
    manifest = bench.capture(PLAN, "calibration")
    check(bench.root, PLAN, manifest)
    subjects = [
        json.loads((bench.root / shot["frames"][0]["file"]).read_bytes())["subject"] for shot in manifest["shots"]
    ]
    assert sorted(subjects) == ["chart", "dark", *4 * ["fabric"], "white"]
    assert manifest["lights"] == []


def test_two_runs_on_new_rigs_give_the_same_manifest(tmp_path: Path) -> None:
    texts = []
    for name in ("a", "b"):
        texts.append(json.dumps(Bench(tmp_path / name).capture(PLAN)))
    assert texts[0] == texts[1]


def test_a_newer_revision_shoots_that_shot_only(bench: Bench) -> None:
    first = bench.capture(PLAN)
    second = bench.capture(PLAN, revisions={"t30_p045": 2})
    assert len(bench.camera.fired) == FRAMES + len(EXPOSURES)
    changed = [a["shot"] for a, b in zip(first["shots"], second["shots"], strict=True) if a != b]
    assert changed == ["t30_p045"]
    check(bench.root, PLAN, second)
    assert (bench.root / "frames/00/t30_p045_e0_r0.raw").exists()
    assert (bench.root / "frames/00/t30_p045_e0_r2.raw").exists()
    third = bench.capture(PLAN, revisions={}, devices=None)
    assert third == second


@pytest.mark.parametrize(("shot", "revision"), [("t30_p046", 1), ("t30_p045", -1), ("t30_p045", True)])
def test_wrong_revisions(bench: Bench, shot: str, revision: Any) -> None:
    with pytest.raises(InputError, match=shot):
        bench.capture(PLAN, revisions={shot: revision})
    assert not (bench.root / "journal.jsonl").exists()


def test_another_set_up_is_shot_anew_and_the_old_frames_are_kept(bench: Bench) -> None:
    first = bench.capture(PLAN)
    second = bench.capture(PLAN, device={"device": "fake", "scene": {"texels": 9}})
    assert len(bench.camera.fired) == 2 * FRAMES
    check(bench.root, PLAN, second)
    kept = {path.name for path in (bench.root / "superseded").rglob("*.raw")}
    assert kept == {Path(frame["file"]).name for shot in first["shots"] for frame in shot["frames"]}


def test_other_exposures_are_shot_anew(bench: Bench) -> None:
    bench.capture(PLAN)
    other = plan_grid("silk", [0, 30], 8, (0.04, 0.002), meridians=8)
    check(bench.root, other, bench.capture(other))
    assert len(bench.camera.fired) == FRAMES + 2 * SHOTS


@pytest.mark.parametrize("harm", ["missing", "short", "changed"])
def test_a_recorded_frame_that_is_not_there_is_shot_again(bench: Bench, harm: str) -> None:
    """The size of all is checked, the content of the last bracket too."""
    manifest = bench.capture(PLAN)
    last = read(bench.root / "journal.jsonl")[0][-2]
    path = bench.root / last["file"]
    if harm == "missing":
        path.unlink()
    else:
        data = path.read_bytes()
        path.write_bytes(data[:-1] if harm == "short" else data[:-1] + b"x")
    again = bench.capture(PLAN)
    assert len(bench.camera.fired) == FRAMES + len(EXPOSURES)
    check(bench.root, PLAN, again)
    assert [shot["shot"] for shot in again["shots"]] == [shot["shot"] for shot in manifest["shots"]]


def test_half_a_bracket_is_completed_on_the_same_rig(bench: Bench) -> None:
    """The host dies between two exposures; the first frames are on the card."""
    stop_after(bench, 4, lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bench.capture(PLAN)
    del bench.camera.expose  # type: ignore[method-assign]
    bench.firmware.sync()
    assert len(bench.camera.card()) == 1
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


@pytest.mark.parametrize("change", ["reboot", "lamp", "foreign file"])
def test_half_a_bracket_is_shot_anew_when_something_changed(bench: Bench, change: str) -> None:
    stop_after(bench, 4, lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bench.capture(PLAN)
    del bench.camera.expose  # type: ignore[method-assign]
    bench.firmware.sync()
    if change == "reboot":
        bench.firmware.reboot()
    if change == "lamp":
        bench.firmware.lamp_factor = 0.98
    if change == "foreign file":
        (bench.camera.folder / "IMG_00900.raw").write_bytes(b"holiday")
    manifest = bench.capture(PLAN)
    numbers = check(bench.root, PLAN, manifest)
    assert 3 not in numbers
    assert len(bench.camera.fired) == FRAMES + 1
    names = {path.name[13:] for path in (bench.root / "quarantine").iterdir()}
    assert names == {"IMG_00004.raw"} | ({"IMG_00900.raw"} if change == "foreign file" else set())
    assert bench.camera.card() == []


def test_files_that_were_there_before_are_left_alone(bench: Bench) -> None:
    (bench.camera.folder / "HOLIDAY.raw").write_bytes(b"holiday")
    check(bench.root, PLAN, bench.capture(PLAN))
    assert [file.name for file in bench.camera.card()] == ["HOLIDAY.raw"]


@pytest.mark.parametrize("fault", ["miss", "error"])
def test_one_missed_exposure_is_taken_again(bench: Bench, fault: str) -> None:
    bench.camera.misbehave = ["", "", "", "", fault]
    assert sorted(check(bench.root, PLAN, bench.capture(PLAN))) == list(range(FRAMES))


def test_two_missed_exposures_stop(bench: Bench) -> None:
    bench.camera.misbehave = ["", "", "", "", "error", "error"]
    with pytest.raises(CameraError, match=r"missed .* twice .*battery"):
        bench.capture(PLAN)
    assert not bench.firmware.shutter_open
    assert kinds(bench.root)[-1] == "fault"
    check(bench.root, PLAN, bench.capture(PLAN))


def test_a_surplus_exposure_is_quarantined(bench: Bench) -> None:
    """Two files where one was asked for: which is ours would be a guess."""
    bench.camera.misbehave = ["", "surplus"]
    numbers = check(bench.root, PLAN, bench.capture(PLAN))
    assert sorted(numbers) == [i for i in range(FRAMES + 2) if i not in (1, 2)]
    assert len(list((bench.root / "quarantine").iterdir())) == 2


def test_an_empty_frame_stops(bench: Bench) -> None:
    bench.camera.misbehave = ["", "empty"]
    with pytest.raises(CameraError, match="empty"):
        bench.capture(PLAN)
    assert len(bench.camera.card()) == len(EXPOSURES)
    assert "frame" not in kinds(bench.root)


def test_unplugged_in_an_exposure(bench: Bench) -> None:
    def unplug() -> None:
        bench.firmware.plugged = False

    stop_after(bench, 5, unplug)
    with pytest.raises(DisconnectedError, match="run the capture again"):
        bench.capture(PLAN)
    bench.firmware.plugged = True
    bench.firmware.advance(5)
    assert not bench.firmware.shutter_open
    numbers = check(bench.root, PLAN, bench.capture(PLAN))
    assert not {3, 4} & set(numbers)
    assert len(bench.camera.fired) == FRAMES + 2


def test_a_reboot_is_survived(bench: Bench) -> None:
    """Hello, home, lamp, warm-up; the bracket under way is shot anew."""
    stop_after(bench, 5, bench.firmware.reboot)
    numbers = check(bench.root, PLAN, bench.capture(PLAN))
    assert sorted(numbers)[:5] == [0, 1, 2, 5, 6]
    assert kinds(bench.root).count("session") == 2


def test_a_stall_stops_and_the_plan_can_be_resumed(bench: Bench) -> None:
    def stall_soon() -> None:
        move = bench.firmware._move

        def stalling(*args: Any) -> Any:
            bench.firmware._stall_at = bench.firmware.clock + 0.3
            return move(*args)

        bench.firmware._move = stalling  # type: ignore[method-assign]

    stop_after(bench, 5, stall_soon)
    with pytest.raises(FaultError, match="STALL"):
        bench.capture(PLAN)
    fired = len(bench.camera.fired)
    with pytest.raises(FaultError, match="STALL"):
        bench.capture(PLAN)
    assert len(bench.camera.fired) == fired
    del bench.firmware._move  # type: ignore[method-assign]
    bench.firmware._clear(Fault.STALL)
    check(bench.root, PLAN, bench.capture(PLAN))


@pytest.mark.parametrize("fault", [Fault.LAMP_OUT, Fault.ESTOP])
def test_latched_faults_stop_with_the_shutter_closed(bench: Bench, fault: Fault) -> None:
    stop_after(bench, 5, lambda: bench.firmware.trip(fault))
    with pytest.raises(FaultError, match=fault.name):
        bench.capture(PLAN)
    assert not bench.firmware.shutter_open
    bench.firmware._clear(fault)
    assert not {3, 4} & set(check(bench.root, PLAN, bench.capture(PLAN)))


def test_a_shutter_that_closes_under_a_bracket(bench: Bench) -> None:
    """All frames land, but some of them are dark."""
    stop_after(bench, 4, bench.firmware._close)
    with pytest.raises(RigError, match="shutter moved"):
        bench.capture(PLAN)
    assert 3 not in check(bench.root, PLAN, bench.capture(PLAN))


def test_a_fault_while_no_host_was_there_voids_the_bracket(bench: Bench) -> None:
    stop_after(bench, 6, lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bench.capture(PLAN)
    del bench.camera.expose  # type: ignore[method-assign]
    bench.firmware.sync()
    bench.firmware.trip(Fault.OVERHEATED)
    with pytest.raises(FaultError, match="OVERHEATED"):
        bench.capture(PLAN)
    bench.firmware._clear(Fault.OVERHEATED)
    assert not {3, 4, 5} & set(check(bench.root, PLAN, bench.capture(PLAN)))


def test_long_exposures_of_a_killed_host_are_not_trusted(bench: Bench) -> None:
    plan = plan_grid("silk", [0, 30], 8, (4.0, 0.5), meridians=8)
    stop_after(bench, 2, lambda: (_ for _ in ()).throw(KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        bench.capture(plan)
    del bench.camera.expose  # type: ignore[method-assign]
    bench.firmware.sync()
    assert min(check(bench.root, plan, bench.capture(plan))) == 2


def test_a_lamp_that_drifts_and_comes_back(bench: Bench) -> None:
    def dim() -> None:
        bench.firmware.lamp_factor = 0.9

    stop_after(bench, 5, dim)
    wait = LampWatch.wait

    def recover(lamp: LampWatch) -> None:
        bench.firmware.lamp_factor = 1.0
        wait(lamp)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(LampWatch, "wait", recover)
        manifest = bench.capture(PLAN)
    numbers = check(bench.root, PLAN, manifest)
    assert not {3, 4, 5} & set(numbers)
    assert "pause" in kinds(bench.root)


def test_a_lamp_that_stays_dim_stops(bench: Bench) -> None:
    def dim() -> None:
        bench.firmware.lamp_factor = 0.9

    stop_after(bench, 5, dim)
    with pytest.raises(RigError, match="lamp"):
        bench.capture(PLAN)


def test_a_camera_without_x_sync_is_noticed(bench: Bench) -> None:
    bench.firmware.sync = lambda: None  # type: ignore[method-assign]
    with pytest.raises(CameraError, match="X-sync"):
        bench.capture(PLAN)


def test_a_rig_without_an_x_sync_counter(bench: Bench) -> None:
    bench.firmware.capabilities = 0
    bench.firmware.sync = lambda: None  # type: ignore[method-assign]
    check(bench.root, PLAN, bench.capture(PLAN))


def test_the_whole_plan_is_checked_before_the_lamp_is_lit(bench: Bench) -> None:
    config = bench.firmware._config
    high = (20_000, *config.high[1:])
    bench.firmware._config = type(config)(config.low, high, config.speeds, config.accelerations, config.watchdog_ms)
    with pytest.raises(LimitError, match="30°"):
        bench.capture(PLAN)
    assert not bench.firmware.lamp_on
    assert bench.camera.fired == []


def test_a_full_disk_deletes_nothing_on_the_card(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    real = bench.camera.download

    def download(name: str, to: Path) -> None:
        if len(bench.camera.fired) > 5:
            to.write_bytes(b"x")
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        real(name, to)

    monkeypatch.setattr(bench.camera, "download", download)
    with pytest.raises(InputError, match="disk is full"):
        bench.capture(PLAN)
    assert len(bench.camera.card()) == len(EXPOSURES)
    assert not list(bench.root.rglob("*.part"))
    assert not bench.firmware.shutter_open
    monkeypatch.undo()
    check(bench.root, PLAN, bench.capture(PLAN))
    assert len(bench.camera.fired) == FRAMES


def test_too_little_space_is_seen_after_the_first_bracket(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**6, 10**6 - 5000, 5000))
    with pytest.raises(InputError, match="free some space"):
        bench.capture(PLAN)
    assert len(bench.camera.fired) == len(EXPOSURES)
    with pytest.raises(InputError, match="free some space"):
        bench.capture(PLAN)
    assert len(bench.camera.fired) == len(EXPOSURES)


def test_two_captures_of_a_fabric(bench: Bench) -> None:
    with Journal(bench.root / "journal.jsonl"), pytest.raises(InputError, match="another capture"):
        bench.capture(PLAN)


def test_a_group_that_is_not_there(bench: Bench) -> None:
    with pytest.raises(InputError, match="group '07'"):
        bench.capture(PLAN, "07")


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_plan(tmp_path / "plan.json", PLAN)
    words = ["capture", "--plan", str(tmp_path / "plan.json"), "--group", "00"]
    out = str(tmp_path / "groups" / "00.json")
    assert main([*words, "--device", "hid", out]) == 2
    assert "no rig (1209:0001) is connected" in capsys.readouterr().err
    assert main([*words, "--device", "virtual", "--revisions", '{"x": 1}', out]) == 2
    assert "revision of 'x'" in capsys.readouterr().err
    assert not (tmp_path / "groups").exists()
    for wrong in ("[1]", "{"):
        assert main([*words, "--device", "virtual", "--virtual", wrong, out]) == 2
        assert f"'{wrong}': is not" in capsys.readouterr().err
    assert DEVICE == {"device": "fake"}
