"""The live view of a capture: its file, the questions, and what a terminal shows."""

import os
import pty
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from kinran.__main__ import main
from kinran.base.files import InputError
from kinran.capture import live, watch
from kinran.capture.live import ANSWER, FrameSeen, Live, LiveFile, answer, read_live, seen
from kinran.capture.watch import histogram, view
from kinran.rig.opening import RigSettings
from kinran.rig.transport import TransportError
from kinran.virtual.dng import Tags, write_dng

FRAME = FrameSeen("frames/00/t30_p000_e0_r0.dng", 0.004, 0.0312, ((0.0,) * 23 + (1.0,),) * 3)


def shown(state: Live, **other: object) -> str:
    console = Console(width=80, force_terminal=False)
    with console.capture() as capture:
        console.print(view(state, **other))  # type: ignore[arg-type]
    return capture.get()


def test_view_says_what_a_person_needs() -> None:
    state = Live(
        "silk", "03", os.getpid(), 100.0, "waits for the lamp", 12, 68, 4000.0, "t30_p000", (30.0, 0.0),
        "on, cold", 1200.0, "1.2 lux·h", "50 lux·h", "battery 78 %", "214 frames free", FRAME, "Put the chart",
    )  # fmt: skip
    text = shown(state, now_s=110.0)
    for words in (
        "silk · group 03", "12 of 68 shots, 67 min left", "waits for the lamp for 10 s", "on, cold, 20 min to wait",
        "θ 30.000°   φ 0.000°", "1.2 lux·h of at most 50 lux·h", "battery 78 %, 214 frames free", "1/250 s",
        "3.12% saturated", "Put the chart, then press Enter", "e emergency stop",
    ):  # fmt: skip
        assert words in text
    assert "ended" in shown(Live("silk", "03", process=2**22 + 1))


def test_histogram_ends_at_saturation() -> None:
    console = Console(width=80, force_terminal=False)
    with console.capture() as capture:
        console.print(histogram(FRAME))
    rows = capture.get().splitlines()
    assert [len(row.rstrip()) for row in rows[1:5]] == [50] * 4
    assert rows[1].rstrip().endswith("██")


def test_a_frame_as_it_is_judged(tmp_path: Path) -> None:
    bayer = np.full((64, 64), 256 + (4095 - 256) // 4, np.uint16)
    bayer[:16] = 4095
    write_dng(tmp_path / "a.dng", bayer, Tags(Fraction(1, 100), 0, 256, 4095, "2000:01:01 00:00:00"))
    frame = seen(tmp_path, "a.dng", 0.01)
    assert frame is not None
    assert frame.saturated == pytest.approx(0.25)
    for row in frame.histogram:
        assert row[-1] == pytest.approx(0.25)
        assert row[19] + row[20] == pytest.approx(0.75)  # two stops below saturation
    (tmp_path / "b.dng").write_bytes(b"no picture")
    assert seen(tmp_path, "b.dng", 0.01) is None


def test_a_question_waits_for_its_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_terminal", lambda: None)
    (tmp_path / ANSWER).touch()  # an old answer is none
    file = LiveFile(tmp_path, Live("silk", "calibration", os.getpid()))
    waits = []

    def wait(seconds: float) -> None:
        waits.append(seconds)
        state = read_live(tmp_path)
        assert state.asked == "Put the white plate before the lens"
        if len(waits) == 3:
            answer(tmp_path)

    file.ask("Put the white plate before the lens", wait)
    assert len(waits) == 3
    assert read_live(tmp_path).asked == ""
    assert not (tmp_path / ANSWER).exists()


def test_a_disk_that_is_full_does_not_stop_the_capture(tmp_path: Path) -> None:
    file = LiveFile(tmp_path, Live("silk", "00", os.getpid()))
    before = read_live(tmp_path)
    (tmp_path / live.LIVE).unlink()
    (tmp_path / live.LIVE).mkdir()
    file.update(done=3)
    assert file.live.done == before.done + 3
    assert [path.name for path in tmp_path.iterdir()] == [live.LIVE]


def test_watching_in_a_terminal(tmp_path: Path) -> None:
    root = tmp_path / "silk"
    root.mkdir()
    file = LiveFile(root, Live("silk", "calibration", os.getpid(), asked="Put the chart before the lens"))
    ours, theirs = pty.openpty()
    words = [sys.executable, "-m", "kinran", "rig", "watch", "silk", "--captures", str(tmp_path)]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "30"}
    with subprocess.Popen(words, stdin=theirs, stdout=theirs, stderr=theirs, env=environment) as process:
        os.close(theirs)
        text = ""

        def read() -> None:
            nonlocal text
            try:
                while data := os.read(ours, 4096):
                    text += data.decode(errors="replace")
            except OSError:
                pass

        thread = threading.Thread(target=read)
        thread.start()

        def until(words: str) -> None:
            end = time.monotonic() + 30
            while words not in text and time.monotonic() < end:
                time.sleep(0.02)
            assert words in text

        until("Put the chart before the lens, then press Enter")
        os.write(ours, b"\n")
        end = time.monotonic() + 30
        while not (root / ANSWER).exists() and time.monotonic() < end:
            time.sleep(0.02)
        assert (root / ANSWER).exists()
        file.update(asked="", done=5, total=9)
        until("5 of 9 shots")
        os.write(ours, b"q")
        assert process.wait(timeout=30) == 0
        thread.join()
    os.close(ours)


def test_without_a_terminal_or_a_capture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "silk").mkdir()
    LiveFile(tmp_path / "silk", Live("silk", "00", process=2**22 + 1, done=2, total=9, phase="complete"))
    assert main(["rig", "watch", "silk", "--captures", str(tmp_path)]) == 0
    assert capsys.readouterr().out == "silk 00: 2 of 9 shots, complete\n"
    assert main(["rig", "watch", "wool", "--captures", str(tmp_path)]) == 2
    assert "wool: no such capture; there are: silk" in capsys.readouterr().err
    (tmp_path / "gold").mkdir()
    with pytest.raises(InputError, match="no capture has run here"):
        read_live(tmp_path / "gold")


def test_the_key_of_the_emergency_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    """It stops the rig even while a capture holds its lock, and ends the capture; else it says what to press."""
    stopped = []

    @contextmanager
    def opened(device: str, settings: RigSettings, alone: bool) -> Iterator[SimpleNamespace]:
        assert (device, settings.usb, settings.serial, alone) == ("hid", "1209:0001", "OGM-1", False)
        yield SimpleNamespace(estop=lambda: stopped.append(True))

    def none(*_: object, **__: object) -> None:
        raise TransportError("no rig is connected")

    for device, opening, words in (
        ("virtual", none, "the capture was stopped"),
        ("hid", opened, "emergency stop sent"),
        ("hid", none, "press the rig's own button: no rig is connected"),
    ):
        monkeypatch.setattr(watch, "open_goniometer", opening)
        with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as capture:
            capture_ends = threading.Timer(20, capture.kill)  # else a key that does nothing would be waited for
            capture_ends.start()
            said = watch.stop_now(Live("silk", "00", capture.pid, device=device, usb="1209:0001", serial="OGM-1"))
            assert capture.wait(timeout=30) == -signal.SIGTERM
            capture_ends.cancel()
        assert said.startswith(words)
    assert stopped == [True]
