"""What a session shoots next: missing shots in a quick order, and the arms' way through them."""

from collections.abc import Sequence

from kinran.capture.arms import Pose, pose_of, way
from kinran.capture.brackets_taken import Wanted
from kinran.capture.order import reorder
from kinran.data.capture_plan import Plan, Shot
from kinran.rig.goniometer import ALL_AXES, Goniometer, check_pose
from kinran.rig.motion import mdeg


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
    """Check all poses of a plan, and the arms' way through the shots that are to be taken.

    Raises
    ------
    LimitError
        A pose is outside the limits, or the arms meet on every way to it.
    """
    for shot in (shot for group in plan.groups for shot in group.shots):
        check_pose(rig.identity, pose_of(shot))
    at = stands(rig)
    for shot in shots:
        at = way(at, shot, rig.identity.axes, mdeg(plan.backlash))[-1]
