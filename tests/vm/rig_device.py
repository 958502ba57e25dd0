"""A rig that the kernel sees: the simulated firmware behind uhid or USB/IP.

The process that drives it writes a word with arguments on a pipe, and gets the rig's true state back as JSON.
"""

import json
import select
import time
from collections.abc import Sequence
from typing import IO, Protocol

from emulated_rig import HOMING_S, Rig, quicker
from rig_conformance import PythonDevice
from rig_uhid import Uhid
from rig_usbip import UsbIp

from kinran.rig import machine
from kinran.rig.motion import AXES
from kinran.rig.protocol import Fault

WARM_UP_S = {True: machine.WARM_UP_S, False: 1.0}
"""Seconds after which the lamp counts as warm: with the host's clock those of the simulated rig, else few."""
LONGEST_WAIT_S = 0.05
"""Longest time that the rig's clock may lag behind the real one, in seconds."""


class Link(Protocol):
    """What joins a rig to the kernel."""

    rig: Rig

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


class Emulator:
    """A rig, its link to the kernel, and its clock.

    Parameters
    ----------
    link
        ``uhid`` or ``vhci``.
    """

    def __init__(self, link: str) -> None:
        self._last = time.monotonic()
        rig = self._rig(hosts_clock=False)
        self._link: Link = Uhid(rig) if link == "uhid" else UsbIp(rig)
        self._link.plug()

    def _rig(self, hosts_clock: bool) -> Rig:
        """Return a rig fresh from its maker, whose time passes at the host's word, or else by itself."""
        machine.WARM_UP_S = WARM_UP_S[hosts_clock]
        rig = Rig() if hosts_clock else Rig(quicker(AXES), HOMING_S)
        self._hosts_clock = hosts_clock
        self._world = PythonDevice(rig)
        self._sent = 0
        return rig

    def serve(self, words: IO[str], answers: IO[str]) -> None:
        """Be a rig until the pipe of words is closed."""
        while True:
            rig, link = self._link.rig, self._link
            wait = min(max(rig.next_due() - rig.clock, 0.0), LONGEST_WAIT_S)
            ready, _, _ = select.select([words, *link.files()], [], [], wait)
            now = time.monotonic()
            if not self._hosts_clock:
                rig.advance(now - self._last)
            self._last = now
            asked = bool(set(ready) & set(link.files()))
            if asked:
                link.serve()
            elif words in ready:  # what the kernel asked before comes first
                line = words.readline()
                if not line:
                    return
                self._obey(line.split())
            self._send()
            if not asked and words in ready:
                print(json.dumps(self._link.rig.truth() | {"sent": self._sent}), file=answers, flush=True)

    def _send(self) -> None:
        """Send what the firmware has to say, and pull the cable if it was pulled."""
        rig = self._link.rig
        while rig.outbox:
            self._link.send(rig.outbox.popleft())
            self._sent += 1
        if not rig.plugged:
            self._link.unplug()

    def _obey(self, words: Sequence[str]) -> None:
        """Do to the rig what a word says."""
        rig = self._link.rig
        match words:
            case ["look"]:
                pass
            case ["fresh"]:
                self._link.rig = self._rig(hosts_clock=True)
            case ["pass", seconds]:
                rig.advance(float(seconds))
            case ["happen", event, axis]:
                self._world.happen(event, int(axis))  # type: ignore[arg-type]
            case ["inject", kind]:
                rig.inject(kind)  # type: ignore[arg-type]
            case ["trip", fault, axis]:
                rig.trip(Fault[fault], int(axis))
            case ["reboot"]:
                rig.restart()
            case ["events", count]:
                for _ in range(int(count)):
                    rig._emit_event()
            case ["raw", report]:
                self._link.send(bytes.fromhex(report))
            case ["mute"]:
                rig.muted = True
            case ["refuse"]:
                rig.refusing = True
            case ["unplug"]:
                rig.plugged = False
            case ["plug"]:
                rig.plugged = True
                self._link.plug()
            case _:
                raise ValueError(f"the rig does not know {words}")
