"""What can go wrong with the rig; every message is one sentence: what happened and what to do."""

from kinran.rig.protocol import Fault, Opcode, Status

_REMEDY = {
    Fault.ESTOP: "release the emergency stop",
    Fault.LIMIT_SWITCH: "move the axis off its switch by hand",
    Fault.STALL: "look for what blocks the axis",
    Fault.LAMP_OUT: "look after the lamp",
    Fault.WATCHDOG: "the host was silent for too long",
    Fault.SHUTTER: "look after the shutter",
    Fault.OVERHEATED: "let the lamp cool",
    Fault.INTERLOCK: "close the door",
    Fault.XSYNC_MISSING: "check the cable between camera and rig",
    Fault.COLLISION: "look where the arms stand",
}


class RigError(Exception):
    """The rig did not do what it was asked."""


class LimitError(RigError):
    """A pose is outside the soft limits; nothing was sent."""


class RigTimeoutError(RigError):
    """The rig does not answer."""


class DisconnectedError(RigError):
    """The rig is gone."""


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
