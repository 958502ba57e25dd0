"""The machine that the guest's kernel meets: the simulated firmware, with the faults of a device beside its own."""

from dataclasses import replace

from kinran.rig import machine
from kinran.rig.firmware import Firmware
from kinran.rig.motion import AXES
from kinran.rig.motion import Four as Axes
from kinran.rig.protocol import Fault, JobState, Opcode, ReportId

SERIAL = "OGM-0001"
"""Serial number of the rig."""
PRODUCT_NAME = "Kinran OGM (emulated)"
"""Name that the rig gives as a USB device."""
RELEASE = 0x0104
"""Release number of the device, in the decimals of USB: 1.4."""
HOMING_S = 0.5
"""Seconds of homing of the quicker rig, which it states in CONFIG, rounded up."""
QUICKER = 4
"""Factor on the speed and acceleration of θ of the quicker rig, which it states in CONFIG; φ is as slow as in `AXES`,
so that much can happen in a move of it."""
FEATURES = (ReportId.IDENT, ReportId.CONFIG, ReportId.STATUS)
"""Features that the rig has; asked for others, it refuses at once."""


class Rig(Firmware):
    """The firmware with what a device has beside it: features that stay unanswered, and packets that are refused.

    Attributes
    ----------
    muted
        Whether the next request for a feature stays unanswered.
    refusing
        Whether the next output report is refused by the USB device (STALL).
    """

    def __init__(self, axes: Axes = AXES, homing_s: float = machine.HOMING_S) -> None:
        self.muted = self.refusing = False
        super().__init__(serial=SERIAL, axes=axes, homing_s=homing_s)

    def restart(self) -> None:
        """Restart with the door closed, and forget what was to go wrong."""
        self._injected.clear()
        self.muted = self.refusing = False
        self.reboot()

    def answers(self, feature: int) -> bool:
        """Return whether a request for a feature is answered, be it by a refusal."""
        muted, self.muted = self.muted, False
        return not muted and (feature not in FEATURES or self.get_feature(feature) is not None)

    def truth(self) -> dict[str, object]:
        """Return the rig's state, as JSON can hold it."""
        state = self.state()
        return {
            "pose": list(self.pose),
            "fault": Fault(state.fault).name,
            "running": state.job_state == JobState.RUNNING,
            "homed": state.homed,
            "shutter": self.shutter_open,
            "lamp": self.lamp_on,
            "flags": state.flags,
            "job": state.job,
            "moves": sum(opcode is Opcode.MOVE for opcode, _ in self.jobs_done),
            "exposures": state.exposures,
            "events": state.event,
            "boot": self.boot,
            "plugged": self.plugged,
        }


def quicker(axes: Axes) -> Axes:
    """Return axes whose θ are `QUICKER` times as quick."""
    light, camera = (
        replace(axis, speed=axis.speed * QUICKER, acceleration=axis.acceleration * QUICKER) for axis in axes[::2]
    )
    return light, axes[1], camera, axes[3]
