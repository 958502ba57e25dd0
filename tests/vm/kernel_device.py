"""The table of scenarios (`rig_scenarios`) on a rig that the kernel sees: one more `rig_conformance.Device`."""

import time
from collections.abc import Callable
from typing import Any

from rig_conformance import PythonDevice, differences, run
from rig_scenarios import Event, Scenario

from kinran.rig.protocol import REPORT
from kinran.rig.transport import Handle

AT_ONCE_S = 4.0
"""Seconds of the rig that pass at once: in a job there are 40 events in them, and hidraw keeps 63."""
ARRIVES_S = 5.0
"""Seconds in which a report that the rig sent arrives."""
SHORTEST = 2
"""Bytes of the shortest report that hidraw sends."""


class KernelDevice:
    """A rig behind a handle of hidapi, whose clock stands until the host lets time pass.

    Parameters
    ----------
    handle
        An open handle of the rig.
    rig
        Way to the rig itself, as `guest_bench.Device`.
    """

    def __init__(self, handle: Handle, rig: Callable[[str], Any]) -> None:
        self._handle = handle
        self._rig = rig
        rig("fresh")
        while handle.read(REPORT, 20):
            pass
        self._received = 0
        self._reports: list[bytes] = []

    def write(self, data: bytes) -> None:
        """Send an output report."""
        data = data.ljust(SHORTEST, b"\0")
        assert self._handle.write(data) == len(data)

    def read(self, replies: int) -> list[bytes]:
        """Return the input reports since the last call: all that the rig has sent."""
        self._collect(self._rig("look").sent)
        reports, self._reports = self._reports, []
        return reports

    def _collect(self, sent: int) -> None:
        until = time.monotonic() + ARRIVES_S
        while self._received < sent:
            assert time.monotonic() < until, f"{sent - self._received} reports did not arrive"
            if report := bytes(self._handle.read(REPORT, 20)):
                self._reports.append(report)
                self._received += 1

    def get_feature(self, report: int) -> bytes | None:
        """Return a feature; None where the rig refuses."""
        try:
            return bytes(self._handle.get_feature_report(report, REPORT))
        except OSError:
            return None

    def set_feature(self, data: bytes) -> bool:
        """Set a feature; return whether the rig took it."""
        return self._handle.send_feature_report(data) == len(data)

    def wait(self, seconds: float) -> None:
        """Let time pass, no more at once than the kernel can queue the events of."""
        while seconds > 0:
            step = min(seconds, AT_ONCE_S)
            self._collect(self._rig(f"pass {step!r}").sent)
            seconds -= step

    def happen(self, event: Event, axis: int) -> None:
        """Do something to the rig."""
        self._rig(f"happen {event} {axis}")


def conforms(scenario: Scenario, device: KernelDevice) -> str:
    """Return in what the rig behind the kernel differs from the table, or from the simulated firmware; or nothing."""
    try:
        found = differences(run(scenario, PythonDevice()), run(scenario, device))
    except AssertionError as error:
        return str(error)
    return ", ".join(found)
