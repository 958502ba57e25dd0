"""The interface of a goniometer to a capture; a rig of another make is a bridge of one file with these methods.

Angles are whole millidegrees; the four axes are light θ, light φ, camera θ, camera φ (docs/rig.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from kinran.rig.errors import FaultError, LimitError, RigError
from kinran.rig.motion import AXES, CLEARANCE_MDEG, Four, Pose, clearance, meeting
from kinran.rig.protocol import Flag, State

ALL_AXES = 0b1111
"""Mask of all axes, as in `State.homed`."""


@dataclass(frozen=True)
class Identity:
    """What a rig says of itself.

    Attributes
    ----------
    serial
        Serial number.
    axes
        Soft limits, top speeds and accelerations of the four axes.
    homing_s
        Longest time that homing takes, in seconds.
    boot
        Number that changes whenever the rig forgets its pose.
    x_sync
        Whether `State.exposures` counts the exposures of the camera.
    photodiode
        Whether `Goniometer.intensity` measures the lamp; without it the monitors alone follow the lamp.
    """

    serial: str
    axes: Four = AXES
    homing_s: float = 60.0
    boot: int = 1
    x_sync: bool = False
    photodiode: bool = True


class Goniometer(Protocol):
    """A light arm with a lamp and its shutter, and perhaps a camera arm.

    Every method but `status` and `close` raises `RigError` when the rig failed; the state after that is unknown until
    `hello`.
    """

    @property
    def identity(self) -> Identity:
        """What the rig said of itself at the last `hello`."""

    @property
    def state(self) -> State:
        """State that the rig reported last."""

    def hello(self) -> State:
        """Meet the rig: read its identity, end what a dead host left running, close the shutter."""

    def status(self) -> State:
        """Read the state, and change nothing."""

    def home(self) -> State:
        """Find the reference of every axis."""

    def move(self, theta_mdeg: int, phi_mdeg: int, camera_mdeg: tuple[int, int] | None = None) -> State:
        """Move the light arm, and the camera arm where `camera_mdeg` says where to; return when both rest.

        `State.position` of the result is what the encoders measured.
        """

    def stop(self) -> State:
        """Stop all motion."""

    def lamp(self, on: bool) -> State:
        """Light the lamp or put it out."""

    def shutter(self, is_open: bool, seconds: float = 30.0) -> State:
        """Open the lamp's shutter, for at most `seconds` even if the host dies, or close it."""

    def intensity(self, seconds: float = 0.1) -> int:
        """Return the light of the lamp in counts of its photodiode, averaged over `seconds`."""

    def wait(self, seconds: float) -> None:
        """Let time pass, in which the rig may report faults."""

    def close(self) -> None:
        """Stop motion, close the shutter, and let go of the rig; the lamp stays lit."""


def check_fault(state: State) -> None:
    """Raise the fault that the rig reported.

    Raises
    ------
    FaultError
        The rig has a fault.
    """
    if state.fault:
        raise FaultError(state.fault, state.fault_axis)


def check_pose(identity: Identity, pose: Sequence[int]) -> None:
    """Check a pose of the light arm, or of both arms, against the limits of the rig and the arms against each other.

    Raises
    ------
    LimitError
        The pose is outside, or the arms meet in it.
    """
    for axis, value in zip(identity.axes, pose, strict=False):
        if not axis.low <= value <= axis.high:
            raise LimitError(
                f"{axis.name} = {value / 1000:g}° is outside the rig's {axis.low / 1000:g}° to"
                f" {axis.high / 1000:g}°; plan other directions"
            )
    if len(pose) == 4 and clearance(pose) < CLEARANCE_MDEG:
        raise LimitError(
            f"the light arm at {_angles(pose[:2])} meets the camera arm at {_angles(pose[2:])}; plan other directions"
        )


def check_path(start: Pose, end: Pose) -> None:
    """Check that the arms do not meet on the way of a coordinated move.

    Raises
    ------
    LimitError
        They come closer than `CLEARANCE_MDEG`.
    """
    if pose := meeting(start, end):
        raise LimitError(
            f"on the way from {_angles(start[:2])} to {_angles(end[:2])} the light arm meets the camera arm"
            f" at {_angles(pose[2:])}; plan another order"
        )


def confirm_shutter(rig: Goniometer, is_open: bool) -> None:
    """Check that the shutter stands as it should.

    Raises
    ------
    RigError
        The shutter moved by itself, or the rig has a fault.
    """
    check_fault(rig.status())
    if rig.state.has(Flag.SHUTTER) != is_open:
        raise RigError("the lamp's shutter moved by itself; check it, then run the capture again")


def _angles(pose: Sequence[float]) -> str:
    theta, phi = pose
    return f"(θ {theta / 1000:g}°, φ {phi / 1000:g}°)"
