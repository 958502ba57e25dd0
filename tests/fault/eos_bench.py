"""A bench with an emulated EOS: the real libgphoto2 takes the frames, and the simulated rig stands beside it.

Run as a script it is `kinran capture --device hid` with these devices, and says at its end how it left the rig.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from eos_emulator import Control, seen

from kinran.capture import capture as stage
from kinran.capture.capture import capture
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import Plan
from kinran.rig.camera import Camera
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import Goniometer
from kinran.rig.gphoto_camera import CameraSettings, GphotoCamera, open_camera
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import mdeg
from kinran.rig.simulation import FRAME_S, simulated_goniometer

EXPOSURES = (0.04, 0.004)


def short_plan(shots: int = 2) -> Plan:
    """A few shots of two exposures."""
    plan = plan_grid("silk", [0, 30], 8, EXPOSURES, meridians=8)
    first = plan.groups[0]
    return replace(plan, groups=(replace(first, shots=first.shots[:shots]), *plan.groups[1:]))


class WiredCamera:
    """A camera that stands before the simulated rig: it sees its light, and is wired to its X-sync socket."""

    def __init__(self, camera: GphotoCamera, eos: Control, firmware: Firmware, rig: HidGoniometer) -> None:
        self._camera, self._eos, self._firmware, self._rig = camera, eos, firmware, rig

    def __getattr__(self, name: str) -> Any:
        return getattr(self._camera, name)

    def expose(self, seconds: float) -> None:
        scene = {"pose": list(self._firmware.pose[:2]), "open": self._firmware.shutter_open}
        before = self._eos.tell(scene=scene)["fired"]
        try:
            self._camera.expose(seconds)
        finally:
            for _ in range(self._eos.tell()["fired"] - before):
                self._firmware.sync()
            self._firmware.advance(FRAME_S)
            self._rig.ping()


class EosBench:
    """An emulated EOS and a simulated rig that live on while hosts come and go."""

    def __init__(self, root: Path, eos: Control, wait_s: float = 1.0) -> None:
        self.root, self.eos, self.wait_s = root, eos, wait_s
        self.firmware = Firmware()
        self.settings = CameraSettings(eos.port)
        self.opened: list[GphotoCamera] = []

    @contextmanager
    def devices(self) -> Iterator[tuple[Goniometer, Camera]]:
        rig = simulated_goniometer(self.firmware)
        camera = GphotoCamera(self.settings, lands_s=self.wait_s, busy_s=3 * self.wait_s)
        self.opened.append(camera)
        try:
            yield rig, WiredCamera(camera, self.eos, self.firmware, rig)  # type: ignore[misc]
        finally:
            rig.close()
            camera.close()

    def capture(self, plan: Plan, **other: Any) -> dict[str, Any]:
        arguments: dict[str, Any] = {"devices": self.devices, "device": {"device": "eos"}, "revisions": {}}
        return capture(plan, "00", self.root, **{**arguments, **other})


def check_frames(root: Path, plan: Plan, manifest: dict[str, Any]) -> list[int]:
    """Check that each frame was taken under its own light at its own exposure; numbers of the exposures."""
    shots = {shot.shot: shot for group in plan.groups for shot in group.shots}
    numbers = []
    for entry in manifest["shots"]:
        shot = shots[entry["shot"]]
        for frame, exposure in zip(entry["frames"], plan.exposures_s, strict=True):
            said = seen(root / frame["file"])
            assert said["exposure"] == frame["exposure_s"] == exposure
            assert abs(said["scene"]["pose"][0] - mdeg(shot.theta)) <= 20
            assert abs(said["scene"]["pose"][1] - mdeg(shot.phi)) <= 20
            assert said["scene"]["open"]
            numbers.append(said["number"])
    return numbers


def kept_aside(root: Path) -> list[int]:
    """Numbers of the exposures in the quarantine."""
    return [seen(path)["number"] for path in (root / "quarantine").glob("*")]


def host(camera_port: int, control_port: int, arguments: list[str]) -> int:
    """Run a command with these devices in place of the real ones."""
    from kinran.__main__ import main

    firmware = Firmware()

    @contextmanager
    def devices(config: Any, root: Path, ask: Callable[[str], None]) -> Iterator[tuple[Goniometer, Camera]]:
        eos = Control(camera_port, control_port)
        with open_camera(CameraSettings(config.camera), lambda subject: None) as camera:
            rig = simulated_goniometer(firmware)
            try:
                yield rig, WiredCamera(camera, eos, firmware, rig)  # type: ignore[misc]
            finally:
                rig.close()

    stage.rig_devices = devices  # type: ignore[assignment]
    code = main(arguments)
    print("shutter open" if firmware.shutter_open else "shutter closed", flush=True)
    return code


if __name__ == "__main__":
    sys.exit(host(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
