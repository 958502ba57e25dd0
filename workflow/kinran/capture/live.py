"""What a running capture tells those who watch it: one small file, and the answers of a person.

A capture that the workflow starts has no terminal of its own. So it writes its state to ``live.json`` in its folder,
which `kinran rig watch` shows in any terminal of the machine, and takes a person's answer from ``answer.json`` there.
"""

import json
import os
import select
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinran.base.files import InputError, read_as
from kinran.data.raw import read_raw

LIVE, ANSWER = "live.json", "answer.json"
"""Names of the two files in the folder of a capture."""
STOPS, STOPS_SHOWN = 12, 24
"""Stops below saturation that a histogram reaches, and its number of bins: two a stop. A frame of 12 bits has as
many stops."""
POLL_S = 0.2
"""Seconds between two looks for an answer."""


@dataclass(frozen=True)
class FrameSeen:
    """The last frame, as a person judges an exposure.

    Attributes
    ----------
    file
        Path relative to the capture's folder.
    exposure_s
        Exposure time in seconds.
    saturated
        Share of the sensor's sites at saturation.
    histogram
        Share of the sites of R, G and B by half stops, from `STOPS` below saturation to saturation.
    """

    file: str
    exposure_s: float
    saturated: float
    histogram: tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Live:
    """The state of a capture that runs, or of the last one that ran.

    Attributes
    ----------
    fabric, group
        What is shot.
    process
        Number of the process that shoots.
    time_s
        Time of the last change in seconds since 1970.
    phase
        What the capture does now, or how it ended, in a few words.
    done, total
        Shots of the group that are taken, and all.
    left_s
        Predicted seconds to the group's end; None before the first shot.
    shot, pose_deg
        Current shot, and light θ and φ in degrees.
    lamp, lamp_s
        State of the lamp in words, and the seconds for which the capture still waits for it; None where unknown.
    dose, dose_limit
        Light on the sample so far, and its limit, in words; empty without one.
    battery, card
        Battery and free space of the camera in words; empty where it does not say.
    frame
        The last frame.
    asked
        What a person is asked to do before the capture goes on; empty for nothing.
    device, usb, serial
        The rig, for its emergency stop.
    """

    fabric: str
    group: str
    process: int
    time_s: float = 0.0
    phase: str = "begins"
    done: int = 0
    total: int = 0
    left_s: float | None = None
    shot: str = ""
    pose_deg: tuple[float, float] | None = None
    lamp: str = ""
    lamp_s: float | None = None
    dose: str = ""
    dose_limit: str = ""
    battery: str = ""
    card: str = ""
    frame: FrameSeen | None = None
    asked: str = ""
    device: str = "virtual"
    usb: str = ""
    serial: str = ""


class LiveFile:
    """Keeps ``live.json`` up to date. It is for people: what cannot be written is left out, and the capture goes on.

    Parameters
    ----------
    root
        Folder of the capture.
    first
        State at the beginning.
    """

    def __init__(self, root: Path, first: Live) -> None:
        self._root = root
        self.live = first
        self.update()

    def update(self, **changes: Any) -> None:
        """Change some attributes of `Live`, and write the file."""
        self.live = replace(self.live, **changes, time_s=time.time())
        temporary = self._root / f".{LIVE}.{os.getpid()}"
        try:
            temporary.write_text(json.dumps(asdict(self.live), ensure_ascii=False), encoding="utf-8")
            temporary.replace(self._root / LIVE)
        except OSError:
            temporary.unlink(missing_ok=True)

    def ask(self, text: str, wait: Callable[[float], None] = time.sleep) -> None:
        """Ask a person to do something, and wait for the answer: Enter in this terminal or in `kinran rig watch`.

        Parameters
        ----------
        text
            What is to be done, as a sentence without a full stop.
        wait
            Function that lets seconds pass.
        """
        answer = self._root / ANSWER
        answer.unlink(missing_ok=True)
        self.update(asked=text, phase="waits for a person")
        terminal = _terminal()
        try:
            if terminal is not None:
                os.write(terminal, f"\n{text}, then press Enter: ".encode())
            while not answer.exists() and not (terminal is not None and _entered(terminal)):
                wait(POLL_S)
        finally:
            if terminal is not None:
                os.close(terminal)
        answer.unlink(missing_ok=True)
        self.update(asked="", phase="goes on")


def read_live(root: Path) -> Live:
    """Read the state of the capture in a folder.

    Raises
    ------
    InputError
        No capture ran there.
    """
    path = root / LIVE
    if not path.exists():
        raise InputError(f"{path}: no capture has run here; start one, then watch it")
    return read_as(path, Live, "the state of a capture", "run the capture again")


def answer(root: Path) -> None:
    """Tell a waiting capture that what it asked for is done."""
    (root / ANSWER).write_text("{}\n", encoding="utf-8")


def seen(root: Path, file: str, exposure_s: float) -> FrameSeen | None:
    """Return histogram and saturation of a frame; None where it is not a RAW file of a Bayer sensor.

    Parameters
    ----------
    root
        Folder of the capture.
    file
        The frame, relative to `root`.
    exposure_s
        Its exposure time in seconds.
    """
    try:
        frame = read_raw(root / file)
    except InputError:
        return None
    range_ = frame.white - frame.black.mean()
    light = (frame.planes - frame.black[:, None, None].astype(np.float32)) / np.float32(range_)
    stops = np.log2(np.maximum(light, 2.0**-STOPS))
    bins = np.clip(((stops + STOPS) * (STOPS_SHOWN / STOPS)).astype(int), 0, STOPS_SHOWN - 1)
    shares = [np.bincount(bins[k].ravel(), minlength=STOPS_SHOWN) / bins[k].size for k in range(4)]
    rows = (shares[0], (shares[1] + shares[2]) / 2, shares[3])
    histogram = tuple(tuple(round(float(v), 5) for v in row) for row in rows)
    return FrameSeen(file, exposure_s, float(np.mean(frame.planes >= frame.white)), histogram)


def _terminal() -> int | None:
    """Open the terminal of this process; None where it has none, or runs behind another program of it."""
    try:
        terminal = os.open("/dev/tty", os.O_RDWR | os.O_NONBLOCK)
    except OSError:
        return None
    try:
        if os.tcgetpgrp(terminal) == os.getpgrp():
            return terminal
    except OSError:
        pass
    os.close(terminal)
    return None


def _entered(terminal: int) -> bool:
    """Return whether a line was entered in a terminal."""
    ready, _, _ = select.select([terminal], [], [], 0)
    return bool(ready) and b"\n" in os.read(terminal, 1024)
