"""A live view of a capture in the terminal: progress, lamp, last frame, what a person is asked to do.

Keys: Enter answers a question, e is the emergency stop, q leaves the view while the capture goes on.
"""

import os
import select
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from rich.console import Console, Group, RenderableType
from rich.live import Live as Screen
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from kinran.base.files import InputError
from kinran.capture.live import STOPS, FrameSeen, Live, answer, read_live
from kinran.rig.errors import RigError
from kinran.rig.opening import RigSettings, open_goniometer
from kinran.rig.transport import TransportError

BLOCKS = " ▁▂▃▄▅▆▇█"
REFRESH_S = 0.25
"""Seconds between two looks at the capture and the keyboard."""


def watch(root: Path) -> None:
    """Show a capture, one group after the other, until the person leaves; without a terminal, print a line for each
    change until the process that shoots has ended.

    Raises
    ------
    InputError
        No capture has run in the folder.
    """
    console, state = Console(), read_live(root)
    if not (sys.stdin.isatty() and console.is_terminal):
        _print_changes(root)
        return
    said = ""
    with _keys(), Screen(view(state), console=console, auto_refresh=False, screen=False) as screen:
        while True:
            key = _key(REFRESH_S)
            if key == "e":
                said = stop_now(state)
            if key in ("\r", "\n") and state.asked:
                answer(root)
            state = read_live(root)
            screen.update(view(state, said), refresh=True)
            if key == "q":
                return


def view(state: Live, said: str = "", now_s: float | None = None) -> RenderableType:
    """Return the view of a state.

    Parameters
    ----------
    state
        State of the capture.
    said
        Message of the view itself, such as that of an emergency stop.
    now_s
        Present time in seconds since 1970, for the age of the state.
    """
    bar = Table.grid(padding=(0, 1))
    bar.add_row(ProgressBar(total=max(state.total, 1), completed=state.done, width=40), _progress(state))
    facts = Table.grid(padding=(0, 2))
    facts.add_column(style="dim")
    pose = f"θ {state.pose_deg[0]:.3f}°   φ {state.pose_deg[1]:.3f}°" if state.pose_deg else ""
    wait = f", {_duration(state.lamp_s)} to wait" if state.lamp_s else ""
    camera = ", ".join(word for word in (state.battery, state.card) if word)
    dose = f"{state.dose} of at most {state.dose_limit}" if state.dose_limit else state.dose
    for name, text in (
        ("shot", f"{state.shot}   {pose}"),
        ("lamp", state.lamp + wait),
        ("light so far", dose),
        ("camera", camera),
    ):
        if text.strip():
            facts.add_row(name, text)
    age = (time.time() if now_s is None else now_s) - state.time_s
    phase = state.phase if alive(state) else f"ended: {state.phase}"
    parts: list[RenderableType] = [bar, Text(phase + (f" for {_duration(age)}" if age > 5 else "")), facts]
    if state.frame:
        parts.append(histogram(state.frame))
    if state.asked:
        parts.append(Panel(Text(f"{state.asked}, then press Enter"), style="bold yellow"))
    if said:
        parts.append(Text(said, style="bold red"))
    parts.append(Text("Enter answers   e emergency stop   q leaves the view, the capture goes on", style="dim"))
    return Panel(Group(*parts), title=f"{state.fabric} · group {state.group}", title_align="left", width=78)


def histogram(frame: FrameSeen) -> RenderableType:
    """Return the histogram of a frame in three rows, from `STOPS` stops below saturation to saturation."""
    name = Path(frame.file).name
    lines = [Text(f"{name}   {_exposure(frame.exposure_s)}   "), *(Text(f"{channel} ") for channel in "RGB")]
    lines[0].append(f"{frame.saturated:.2%} saturated", style="bold red" if frame.saturated > 0.01 else "green")
    most = max((max(row) for row in frame.histogram), default=0.0) or 1.0
    for line, row, style in zip(lines[1:], frame.histogram, ("red", "green", "blue"), strict=True):
        line.append("".join(BLOCKS[min(8, int(8.99 * (share / most) ** 0.5))] * 2 for share in row), style=style)
    lines.append(Text(f"  −{STOPS} stops{'saturation':>{2 * len(frame.histogram[0]) - 9}}", style="dim"))
    return Group(*lines)


def stop_now(state: Live) -> str:
    """Stop the rig at once, and the capture that drives it; return what was done."""
    done = "the capture was stopped"
    if state.device != "virtual":
        try:
            with open_goniometer(state.device, RigSettings(state.usb, state.serial), alone=False) as rig:
                rig.estop()
            done = "emergency stop sent; `kinran rig home` clears it"
        except (RigError, TransportError) as error:
            done = f"press the rig's own button: {error}"
    with suppress(ProcessLookupError):
        os.kill(state.process, signal.SIGTERM)
    return done


def _print_changes(root: Path) -> None:
    last = ""
    while True:
        state = read_live(root)
        line = f"{state.fabric} {state.group}: {_progress(state)}, {state.phase}"
        line += (
            f": {state.asked}, then press Enter in a terminal with `kinran rig watch {state.fabric}`"
            if state.asked
            else ""
        )
        if line != last:
            print(line, flush=True)
            last = line
        if not alive(state):
            return
        time.sleep(1.0)


def alive(state: Live) -> bool:
    """Return whether the process that shoots still runs."""
    try:
        os.kill(state.process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def _progress(state: Live) -> str:
    left = "" if state.left_s is None else f", {_duration(state.left_s)} left"
    return f"{state.done} of {state.total} shots{left}"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _exposure(seconds: float) -> str:
    return f"1/{1 / seconds:.0f} s" if seconds < 0.3 else f"{seconds:g} s"


@contextmanager
def _keys() -> Iterator[None]:
    """Read single keys from the terminal; Ctrl-C still works."""
    before = termios.tcgetattr(sys.stdin)
    tty.setcbreak(sys.stdin)
    try:
        yield
    finally:
        termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)


def _key(seconds: float) -> str:
    ready, _, _ = select.select([sys.stdin], [], [], seconds)
    return os.read(sys.stdin.fileno(), 1).decode(errors="replace") if ready else ""


def folder(captures: Path, fabric: str) -> Path:
    """Return the folder of a fabric's capture.

    Raises
    ------
    InputError
        There is none.
    """
    found = captures / fabric
    if not found.is_dir():
        names = ", ".join(sorted(path.name for path in captures.glob("*") if path.is_dir())) or "none"
        raise InputError(f"{found}: no such capture; there are: {names}")
    return found
