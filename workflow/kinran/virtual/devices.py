"""The virtual rig and its camera, as a capture opens them; all code that decides their frames is imported here."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kinran.data.capture_plan import Plan, Shot
from kinran.rig.camera import Camera
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.simulation import FRAME_S, PacedCamera
from kinran.rig.transport import SimulatedHid
from kinran.virtual.simulated_camera import CACHE, SUBJECTS, SimulatedCamera

FIRST_S = 2100.0
"""Clock of the rig at a group's first shot, in seconds: by then it is homed, and its lamp has been warm (after half an
hour) and seen to be steady."""
WAY_S = 60.0
"""Seconds for the way of both arms to a shot, wherever they stand: more than the longest way of the simulated rig."""
LISTEN_S = 0.01
"""Seconds before that time in which no reports are waited for: more than the millisecond of a wait's last step."""


class PunctualRig(HidGoniometer):
    """The driver of a simulated rig that measures its lamp, before a shot, no sooner than at the time of that shot.

    Attributes
    ----------
    due
        That time, on the rig's clock in seconds.
    """

    def __init__(self, firmware: Firmware) -> None:
        super().__init__(SimulatedHid(firmware), clock=lambda: firmware.clock, live=False)
        self._firmware = firmware
        self.due = 0.0

    def intensity(self, seconds: float = 0.1) -> int:
        """Wait for the time that is due, and return the counts of the photodiode; see `HidGoniometer.intensity`."""
        self.wait(self.due - self._firmware.clock - LISTEN_S)
        self._firmware.advance(max(self.due - self._firmware.clock, 0.0))  # to the very tick
        return super().intensity(seconds)


@dataclass
class VirtualGroup:
    """A group that is shot on the virtual rig, where each shot has a time of its own.

    So a capture that was killed goes on as if it had not been: the frames that are taken after it, or again, are those
    that would have been taken, lamp and noise included.

    Attributes
    ----------
    root
        Folder of the capture, in which the camera's card lies.
    scene
        The virtual fabric.
    plan, group
        The plan, and the group of it.
    revisions
        Revision that is asked for, by shot; 0 for the others.
    """

    root: Path
    scene: Mapping[str, Any]
    plan: Plan
    group: str
    revisions: Mapping[str, int]
    _devices: "tuple[PunctualRig, SimulatedCamera] | None" = field(default=None, init=False)

    @contextmanager
    def devices(self) -> Iterator[tuple[Goniometer, Camera]]:
        """Open the rig and the camera; what a killed capture left on the card is thrown away: it is taken again."""
        with _opened(self.root, self.scene, self.group) as (rig, firmware, camera):
            for file in camera.card():
                camera.delete(file.name)
            self._devices = rig, camera
            yield rig, PacedCamera(camera, firmware, rig)
        self._devices = None

    def begin(self, name: str) -> None:
        """Set the time of a shot of the group, and the noise of its frames, before the arm goes there."""
        assert self._devices
        rig, camera = self._devices
        shots = self.plan.group(self.group).shots
        place = [shot.shot for shot in shots].index(name)
        same = [shot.shot for shot in shots if _looks(shot) == _looks(shots[place])]
        camera.repeat = same.index(name) + len(same) * self.revisions.get(name, 0)
        bracket = sum(seconds + 2 * FRAME_S for seconds in self.plan.exposures_s)
        rig.due = FIRST_S + place * (WAY_S + bracket)


def _looks(shot: Shot) -> tuple[str, float, float]:
    """Return what the camera sees at a shot: subject, and light θ and φ in degrees."""
    return shot.kind if shot.kind in SUBJECTS else "fabric", shot.theta, shot.phi if shot.theta else 0.0


@contextmanager
def virtual_devices(root: Path, scene: Mapping[str, Any], name: str) -> Iterator[tuple[Goniometer, Camera]]:
    """Open a simulated rig, and a simulated camera with its card in `root`, for shots that are in no plan."""
    with _opened(root, scene, name) as (rig, firmware, camera):
        yield rig, PacedCamera(camera, firmware, rig)


@contextmanager
def _opened(root: Path, scene: Mapping[str, Any], name: str) -> Iterator[tuple[PunctualRig, Firmware, SimulatedCamera]]:
    firmware = Firmware()
    rig = PunctualRig(firmware)
    camera = SimulatedCamera(firmware, root / "card", dict(scene), CACHE, name)
    try:
        yield rig, firmware, camera
    finally:
        rig.close()
