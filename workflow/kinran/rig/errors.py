"""Errors of the rig; every message is one sentence: what happened and the remedy."""

from kinran.rig.protocol import Fault, Opcode, Status

_REMEDY = {
    Fault.ESTOP: "release the emergency stop",
    Fault.LIMIT_SWITCH: "move the axis off its switch by hand",
    Fault.STALL: "look for what blocks the axis",
    Fault.LAMP_OUT: "check the lamp",
    Fault.WATCHDOG: "find out why the host was silent for too long",
    Fault.SHUTTER: "check the shutter",
    Fault.OVERHEATED: "let the lamp cool",
    Fault.INTERLOCK: "close the door",
    Fault.XSYNC_MISSING: "check the cable between camera and rig",
    Fault.COLLISION: "check where the arms stand",
}


class RigError(Exception):
    """Failure of the rig."""


class LimitError(RigError):
    """A pose is outside the soft limits; nothing was sent."""


class RigTimeoutError(RigError):
    """The rig does not answer."""


class DisconnectedError(RigError):
    """The rig is disconnected."""


class RebootedError(RigError):
    """The rig restarted, so that its pose and lamp are unknown."""


class OffTargetError(RigError):
    """An axis came to rest off its target twice."""


class RefusedError(RigError):
    """The rig refused a command."""

    def __init__(self, opcode: int, status: int) -> None:
        super().__init__(
            f"the rig refused {Opcode(opcode).name} with {Status(status).name}; run `kinran rig status`, then home it"
        )
        self.status = Status(status)


class FaultError(RigError):
    """The rig latched a fault and stands still until it is cleared."""

    def __init__(self, fault: int, axis: int) -> None:
        self.fault = Fault(fault)
        self.axis = axis
        where = f" on axis {axis}" if axis != 0xFF else ""
        remedy = _REMEDY.get(self.fault, "read the manual of the rig")
        super().__init__(
            f"the rig stopped with fault {fault}, {self.fault.name}{where}: {remedy}, then run"
            " `kinran rig home` and the capture again"
        )
