"""Opening a goniometer by what the config or a command says of it."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass

from kinran.base.files import InputError
from kinran.rig.firmware import Firmware
from kinran.rig.hid_goniometer import HidGoniometer
from kinran.rig.motion import Four, with_motion
from kinran.rig.simulation import simulated_goniometer
from kinran.rig.transport import PRODUCT, VENDOR, open_hid, rig_lock


@dataclass(frozen=True)
class RigSettings:
    """What the config says of the rig; what it leaves out, the rig itself states (CONFIG).

    Attributes
    ----------
    usb
        VENDOR:PRODUCT in hexadecimal.
    serial
        Serial number, where several rigs are connected; empty for the only one.
    speeds, accelerations
        Top speeds in deg/s and accelerations in deg/s² of light θ, light φ, camera θ, camera φ.
    homing_s
        Longest time of homing in seconds.
    """

    usb: str = f"{VENDOR:04x}:{PRODUCT:04x}"
    serial: str = ""
    speeds: Sequence[float | None] = ()
    accelerations: Sequence[float | None] = ()
    homing_s: float | None = None

    def motion(self, axes: Four) -> Four:
        """Return axes with the speeds and accelerations of the config."""
        return with_motion(axes, self.speeds, self.accelerations)


def usb_pair(text: str) -> tuple[int, int]:
    """Parse vendor and product id such as ``1209:0001``.

    Raises
    ------
    InputError
        The text is something else.
    """
    if not re.fullmatch("[0-9a-fA-F]{1,4}:[0-9a-fA-F]{1,4}", text):
        raise InputError(f"'{text}': is not VENDOR:PRODUCT in hexadecimal; give it as 1209:0001")
    vendor, product = (int(word, 16) for word in text.split(":"))
    return vendor, product


@contextmanager
def open_goniometer(device: str, settings: RigSettings, alone: bool = True) -> Iterator[HidGoniometer]:
    """Open a rig, and close it at the end; nothing is sent to it before its `hello`.

    Parameters
    ----------
    device
        ``virtual`` or ``hid``.
    settings
        What the config says of the rig.
    alone
        Whether a real rig is locked, so that no other program drives it; an emergency stop does without.

    Raises
    ------
    InputError, TransportError
        The rig cannot be opened, or another program drives it.
    """
    if device == "virtual":
        rig = simulated_goniometer(Firmware())
        try:
            yield rig
        finally:
            rig.close()
        return
    opened = open_hid(settings.serial or None, *usb_pair(settings.usb))
    rig = HidGoniometer(opened.handle, motion=settings.motion, homing_s=settings.homing_s)
    with rig_lock(opened.path, opened.serial) if alone else nullcontext():
        try:
            yield rig
        finally:
            rig.close()
