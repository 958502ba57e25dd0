"""A simulated rig and its camera, put together so that time and X-sync pass between them."""

from pathlib import Path

from kinran.rig.camera import Camera, CardFile, FrameFacts, Health
from kinran.rig.firmware import Firmware
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.transport import Backend, SimulatedHid

FRAME_S = 1.0
"""Seconds that a frame takes besides its exposure, the same as `kinran.capture.assembly.CAMERA_S`."""
_SLICE_S = 1.0
"""Seconds of virtual time between two commands that feed the watchdog, which trips after 2 s."""


def simulated_goniometer(firmware: Firmware, backend: Backend = "hidraw") -> HidGoniometer:
    """Return the driver of a simulated rig, on the rig's virtual clock."""
    return HidGoniometer(SimulatedHid(firmware, backend), clock=lambda: firmware.clock, live=False)


class PacedCamera:
    """A simulated camera whose exposures take the rig's time, and whose X-sync socket is wired to the rig.

    Parameters
    ----------
    camera
        The camera itself.
    firmware, rig
        The simulated rig, and its driver, whose heartbeat is kept up while the camera works.
    """

    def __init__(self, camera: Camera, firmware: Firmware, rig: HidGoniometer) -> None:
        self.suffix = camera.suffix
        self._camera = camera
        self._firmware = firmware
        self._rig = rig

    def place(self, subject: str) -> None:
        """Ask for a subject; see `Camera.place`."""
        self._camera.place(subject)

    def expose(self, seconds: float) -> None:
        """Take one frame while the rig's time passes; see `Camera.expose`."""
        self._camera.expose(seconds)
        self._firmware.sync()
        left = seconds + FRAME_S
        while left > 0:
            self._firmware.advance(min(left, _SLICE_S))
            self._rig.ping()
            left -= _SLICE_S

    @property
    def iso(self) -> float:
        """See `Camera.iso`."""
        return self._camera.iso

    @property
    def aperture(self) -> float:
        """See `Camera.aperture`."""
        return self._camera.aperture

    def card(self) -> list[CardFile]:
        """Return the frames on the card; see `Camera.card`."""
        return self._camera.card()

    def download(self, name: str, to: Path) -> None:
        """Copy a file from the card; see `Camera.download`."""
        self._camera.download(name, to)

    def digest(self, name: str) -> str:
        """Read a file on the card once more; see `Camera.digest`."""
        return self._camera.digest(name)

    def facts(self, path: Path) -> FrameFacts:
        """Decode a copy of a frame; see `Camera.facts`."""
        return self._camera.facts(path)

    def health(self) -> Health:
        """Return battery and free space; see `Camera.health`."""
        return self._camera.health()

    def delete(self, name: str) -> None:
        """Delete a file on the card; see `Camera.delete`."""
        self._camera.delete(name)
