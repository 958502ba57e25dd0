"""The arms of the rig on their way to a shot: where they stand for it, and how they come there without meeting."""

import itertools
from collections.abc import Sequence

from kinran.data.capture_plan import Shot
from kinran.rig.errors import LimitError
from kinran.rig.goniometer import Goniometer, check_path
from kinran.rig.motion import AXES, ON_TARGET_MDEG, SETTLE_S, Axis, approach, mdeg, move_time
from kinran.rig.motion import Pose as FourAxes

Pose = tuple[int, ...]

CAMERA_ON_N = (0, 0)
"""Pose of the camera arm in millidegrees that looks along the normal."""


def pose_of(shot: Shot) -> Pose:
    """Return the pose of a shot in millidegrees: two axes, or four where the shot says where the camera stands."""
    light = (mdeg(shot.theta), mdeg(shot.phi))
    return light if shot.camera is None else (*light, mdeg(shot.camera[0]), mdeg(shot.camera[1]))


def way(start: Sequence[int], shot: Shot, axes: Sequence[Axis] = AXES, backlash: int = 0) -> list[Pose]:
    """Return the poses of four axes that bring the arms from where they stand to a shot, the shot's own last.

    The camera goes to N where the shot does not say where it stands. Where the arms would meet on the straight way, one
    of them goes first.

    Parameters
    ----------
    start
        Pose of the four axes in which the rig stands, in millidegrees. An axis that is on its target stays there.
    shot
        Shot to go to.
    axes, backlash
        As in `travel_time`.

    Raises
    ------
    LimitError
        The arms meet on each of these ways.
    """
    wanted = (*pose_of(shot), *CAMERA_ON_N)[:4]
    at = tuple(a if abs(a - b) <= ON_TARGET_MDEG else b for a, b in zip(start, wanted, strict=True))
    target: Pose = (*wanted[:2], *at[2:])
    corners = [[target], [(*start[:2], *target[2:]), target], [(*target[:2], *start[2:]), target]]
    for stops in corners:
        poses = [tuple(start)]
        for stop in stops:
            poses += approach(poses[-1], stop, backlash, axes)
        try:
            for a, b in itertools.pairwise(poses):
                check_path(_four(a), _four(b))
        except LimitError as error:
            met = error
        else:
            return poses[1:]
    raise met


def shots_time(shots: Sequence[Shot], axes: Sequence[Axis] = AXES, backlash: int = 0) -> float:
    """Return the seconds of all moves from the first shot to the last, with a rest in each pose on the way.

    Parameters and errors are those of `way`.
    """
    total, at = 0.0, (*pose_of(shots[0]), *CAMERA_ON_N)[:4]
    for shot in shots[1:]:
        poses = [at, *way(at, shot, axes, backlash)]
        total += sum(move_time(a, b, axes) for a, b in itertools.pairwise(poses)) + SETTLE_S * (len(poses) - 2)
        at = poses[-1]
    return total


def go(rig: Goniometer, shot: Shot, backlash: int = 0) -> FourAxes:
    """Bring the arms to a shot by its `way`, and return the pose that the encoders measured.

    The camera arm gets no command where it has not to move: a rig may have none.

    Raises
    ------
    RigError
        The arms would meet, or a move failed.
    """
    for pose in way(rig.state.position, shot, rig.identity.axes, backlash):
        theta, phi, *camera = pose
        moves = tuple(camera) != rig.state.position[2:]
        rig.move(theta, phi, (camera[0], camera[1]) if moves else None)
    return rig.state.position


def _four(pose: Pose) -> FourAxes:
    a, b, c, d = pose
    return a, b, c, d
