"""The virtual rig and its camera, as a capture opens them; all code that decides their frames is imported here."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kinran.rig.camera import Camera
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.simulation import PacedCamera, simulated_goniometer
from kinran.virtual.simulated_camera import CACHE, SimulatedCamera


@contextmanager
def virtual_devices(root: Path, scene: dict[str, Any], group: str) -> Iterator[tuple[Goniometer, Camera]]:
    """Open a simulated rig, and a simulated camera with its card in `root`, for a group of the plan."""
    firmware = Firmware()
    rig = simulated_goniometer(firmware)
    camera: Camera = SimulatedCamera(firmware, root / "card", scene, CACHE, group)
    try:
        yield rig, PacedCamera(camera, firmware, rig)
    finally:
        rig.close()
