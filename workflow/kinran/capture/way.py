"""The way of the arms through the shots of a session: where they stand, in which order, and whether they meet."""

from collections.abc import Sequence

from kinran.capture.brackets_taken import Wanted
from kinran.capture.order import pose_of, reorder
from kinran.data.capture_plan import Plan, Shot
from kinran.rig.goniometer import ALL_AXES, Goniometer, check_path, check_pose
from kinran.rig.motion import Pose, mdeg


def arms(shot: Shot) -> Pose:
    """Return the pose of both arms for a shot in millidegrees; the camera stands on N if the shot does not say."""
    camera = shot.camera or (0.0, 0.0)
    return mdeg(shot.theta), mdeg(shot.phi), mdeg(camera[0]), mdeg(camera[1])


def stands(rig: Goniometer) -> Pose:
    """Return where the arms stand, or will stand when they are homed."""
    return rig.state.position if rig.state.homed == ALL_AXES else (0, 0, 0, 0)


def in_order(rig: Goniometer, todo: Sequence[Wanted], half: str) -> list[Wanted]:
    """Return missing shots in a quick order from where the arms stand; the shot `half`, half taken, comes first."""
    first = [want for want in todo if want.shot.shot == half]
    rest = {want.shot.shot: want for want in todo if want.shot.shot != half}
    start = pose_of(first[0].shot) if first else stands(rig)
    return first + [rest[shot.shot] for shot in reorder(start, [w.shot for w in rest.values()], rig.identity.axes)]


def check_way(rig: Goniometer, plan: Plan, shots: Sequence[Shot]) -> None:
    """Check all poses of a plan, and the way through the shots that are to be taken.

    Raises
    ------
    LimitError
        A pose is outside the limits, or the arms meet on the way.
    """
    for shot in (shot for group in plan.groups for shot in group.shots):
        check_pose(rig.identity, arms(shot))
    at = stands(rig)
    for shot in shots:
        check_path(at, arms(shot))
        at = arms(shot)
