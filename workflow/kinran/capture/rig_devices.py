"""The real rig and its camera, as a capture opens them by what the config says."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from kinran.base.files import InputError, fitted, read_json, write_json
from kinran.capture.light_dose import Lighting
from kinran.rig.camera import Camera
from kinran.rig.goniometer import Goniometer
from kinran.rig.gphoto_camera import CameraSettings, open_camera
from kinran.rig.opening import RigSettings, open_goniometer
from kinran.rig.transport import TransportError

ASKED = {
    "fabric": "Put the fabric {fabric} under the lens, in its place",
    "white": "Put the white plate on the fabric's place",
    "chart": "Put the colour chart on the fabric's place",
    "dark": "Put the cap on the lens",
}
"""What a person is asked for before the shots of each subject."""
ON_THE_RIG = Path(".cache/kinran/on-the-rig.json")
"""File that says what lies under the lens, for the captures of all fabrics of a project."""


@dataclass(frozen=True)
class RigConfig:
    """Keys of the config's ``rig`` that concern the devices (workflow/schemas/config.schema.yaml says more of each)."""

    camera: str = CameraSettings.port
    iso: float | None = None
    aperture: float | None = None
    usb: str = RigSettings.usb
    serial: str = ""
    speeds: tuple[float | None, ...] = ()
    accelerations: tuple[float | None, ...] = ()
    homing_s: float | None = None
    lux: float | None = None
    dose_limit_lux_h: float | None = None

    @property
    def device(self) -> dict[str, Any]:
        """What decides the frames: frames of other settings are shot anew."""
        asked = {"iso": self.iso, "aperture": self.aperture}
        return {"device": "hid"} | {name: value for name, value in asked.items() if value is not None}

    @property
    def lighting(self) -> Lighting:
        """Illuminance on the sample, and the limit of its dose."""
        return Lighting(self.lux, self.dose_limit_lux_h)


def rig_config(value: Mapping[str, Any]) -> RigConfig:
    """Return the settings of an object of JSON.

    Raises
    ------
    InputError
        A key is unknown, or a value of another type; or there is a limit of the dose, and no lux.
    """
    if unknown := sorted(set(value) - set(RigConfig.__dataclass_fields__)):
        raise InputError(f"--rig: '{unknown[0]}' is not known; it takes {', '.join(RigConfig.__dataclass_fields__)}")
    config = fitted(Path("--rig"), dict(value), RigConfig, "the devices of a config", "correct the config")
    if config.dose_limit_lux_h is not None and config.lux is None:
        raise InputError("rig.dose_limit_lux_h: a limit needs rig.lux, the illuminance on the fabric; measure it")
    return config


@contextmanager
def rig_devices(config: RigConfig, root: Path, ask: Callable[[str], None]) -> Iterator[tuple[Goniometer, Camera]]:
    """Open the rig on USB and its camera; the rig is closed first, so that the shutter closes at once.

    Parameters
    ----------
    config
        What the config says of them.
    root
        Folder of the capture.
    ask
        Function that asks a person to do something, and returns when it is done.

    Raises
    ------
    InputError
        The rig cannot be opened, or another program drives it.
    """
    camera = CameraSettings(config.camera, config.iso or 0.0, config.aperture or 0.0)
    rig = RigSettings(config.usb, config.serial, config.speeds, config.accelerations, config.homing_s)
    try:
        with open_camera(camera, partial(put, root, ask)) as taken, open_goniometer("hid", rig) as opened:
            yield opened, taken
    except TransportError as error:
        raise InputError(str(error)) from None


def put(root: Path, ask: Callable[[str], None], subject: str) -> None:
    """Ask a person for a subject of a capture, unless it is what was put under the lens last.

    So each group of a fabric begins without a question, and another fabric does not.
    """
    wanted = {"capture": str(root.resolve()), "subject": subject}
    if ON_THE_RIG.exists() and read_json(ON_THE_RIG) == wanted:
        return
    ON_THE_RIG.unlink(missing_ok=True)  # while it is changed, nobody knows
    ask(ASKED[subject].format(fabric=root.name))
    write_json(ON_THE_RIG, wanted)
