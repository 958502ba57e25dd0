"""A rig that the kernel sees: the simulated firmware in real time, behind uhid or USB/IP.

The process that drives it writes a word with arguments on a pipe, and gets the rig's true state back as JSON.
"""

import json
import select
import time
from collections.abc import Sequence
from typing import IO, Protocol

from emulated_rig import Rig
from rig_uhid import Uhid
from rig_usbip import UsbIp

from kinran.rig import machine
from kinran.rig.protocol import Fault

WARM_UP_S = 1.0
"""Seconds after which the lamp counts as warm, in place of half an hour."""
LONGEST_WAIT_S = 0.05
"""Longest time that the rig's clock may lag behind the real one, in seconds."""


class Link(Protocol):
    """What joins the rig to the kernel."""

    def plug(self) -> None:
        """Put the cable in."""

    def unplug(self) -> None:
        """Pull the cable out, if it is in."""

    def files(self) -> list[int]:
        """Return the files on which the kernel's requests arrive."""

    def serve(self) -> None:
        """Handle one request of the kernel."""

    def send(self, report: bytes) -> None:
        """Send an input report."""


def serve(name: str, words: IO[str], answers: IO[str]) -> None:
    """Be a rig, on ``uhid`` or ``vhci``, until the pipe of words is closed."""
    machine.WARM_UP_S = WARM_UP_S
    rig = Rig()
    link: Link = Uhid(rig) if name == "uhid" else UsbIp(rig)
    link.plug()
    last = time.monotonic()
    while True:
        wait = min(max(rig.next_due() - rig.clock, 0.0), LONGEST_WAIT_S)
        ready, _, _ = select.select([words.fileno(), *link.files()], [], [], wait)
        now = time.monotonic()
        rig.advance(now - last)
        last = now
        if set(ready) & set(link.files()):
            link.serve()
        if words.fileno() in ready:
            line = words.readline()
            if not line:
                return
            obey(rig, link, line.split())
            print(json.dumps(rig.truth()), file=answers, flush=True)
        while rig.outbox:
            link.send(rig.outbox.popleft())
        if not rig.plugged:
            link.unplug()


def obey(rig: Rig, link: Link, words: Sequence[str]) -> None:
    """Do to the rig what a word says."""
    match words:
        case ["look"]:
            pass
        case ["inject", *kinds]:
            rig.inject(*kinds)  # type: ignore[arg-type]
        case ["trip", fault, axis]:
            rig.trip(Fault[fault], int(axis))
        case ["door", state]:
            rig.set_interlock(state == "open")
        case ["reboot"]:
            rig.restart()
        case ["events", count]:
            for _ in range(int(count)):
                rig._emit_event()
        case ["raw", report]:
            link.send(bytes.fromhex(report))
        case ["mute"]:
            rig.muted = True
        case ["refuse"]:
            rig.refusing = True
        case ["unplug"]:
            rig.plugged = False
        case ["plug"]:
            rig.plugged = True
            link.plug()
        case _:
            raise ValueError(f"the rig does not know {words}")
