"""A plan put together: groups in the order in which they are shot, side views, calibration, duration and light dose."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from kinran.base.distances import Distances, check_lengths
from kinran.base.files import InputError, check_name
from kinran.base.frames import direction
from kinran.capture.arms import Pose, pose_of, shots_time
from kinran.capture.order import EVEN_S, PLACE_S, order_group, order_views
from kinran.data.capture_plan import Group, Plan, PlanLight, RigKind, Shot, Vector
from kinran.rig.errors import LimitError
from kinran.rig.goniometer import Identity, check_pose
from kinran.rig.motion import AXES, SETTLE_S, Four, mdeg

CAMERA_S = 1.0
"""Seconds under the open shutter that a camera needs for a frame besides its exposure: 1.07 to set and release it
until the frame is known of (`kinran bench camera`, an emulated EOS without delays)."""
FETCH_S = 0.5
"""Seconds in which a frame of 20 MB is fetched, read again, decoded and deleted, under the closed shutter: 0.47 in the
same benchmark."""
LARGEST_GROUP = 64
"""Most lights of a group: eight shards, so that a group is merged, or repeated, in minutes."""
CALIBRATION = "calibration"
"""Name of the group of calibration shots."""
VIEWS = "views"
"""Name of the group of side views."""
CALIBRATION_MONITORS = 4
"""Shots of the fabric at θ = 0 in the group of the white plate, as many as in a group of four meridians: their mean
halves the noise of the ratio between fabric and plate."""
MOST_BACKLASH = 5.0
"""Largest play of an axis in degrees: a choice; a rig with more of it needs a mechanic."""
HOME: Pose = (0, 0)
"""Pose in millidegrees from which the first group is reached."""
LIT = ("light", "monitor", "view")
"""Kinds of shots that light the fabric."""


@dataclass(frozen=True)
class Rig:
    """What a plan has to know of the rig.

    Attributes
    ----------
    axes
        Limits, speeds and accelerations of its axes.
    backlash
        Play of the axes in degrees, as in `Plan`.
    photodiode
        Whether it measures its lamp at every shot; else monitors, spread evenly, are all that follows the lamp.
    """

    axes: Four = AXES
    backlash: float = 0.0
    photodiode: bool = True


RIG = Rig()
"""A rig that has not said its axes, without play, with a photodiode."""


@dataclass(frozen=True)
class Members:
    """The lights of a group, and the names of its monitors in the order in which they are shot."""

    lights: Sequence[PlanLight]
    monitors: Sequence[str]


def assemble(
    fabric: str,
    kind: RigKind,
    exposures_s: Sequence[float],
    lights: Sequence[PlanLight],
    groups: Mapping[str, Members],
    distances: Distances,
    rig: Rig,
    views: Sequence[Shot] = (),
) -> Plan:
    """Return the plan of a rig.

    Parameters
    ----------
    fabric
        Name of the fabric.
    kind
        ``grid`` or ``directions``.
    exposures_s
        Exposure times of a bracket in seconds.
    lights
        All lights in the order of their indices, that at θ = 0 last.
    groups
        Lights and monitors of each group by its name. The light at θ = 0 has no shot but the monitors.
    distances
        Distances of lamp and camera from the field's centre, and width of the field that the camera sees.
    rig
        What is known of the rig.
    views
        Front view and side views.

    Raises
    ------
    InputError
        A value is out of range, or a pose or a way is outside the limits.
    """
    check_name(fabric, "fabric")
    if not exposures_s or not all(math.isfinite(e) and 0 < e <= 60 for e in exposures_s):
        raise InputError(f"exposures {list(exposures_s)}: give seconds between 0 and 60")
    if not (math.isfinite(rig.backlash) and 0 <= rig.backlash <= MOST_BACKLASH):
        raise InputError(f"backlash {rig.backlash:g}: give degrees from 0 to {MOST_BACKLASH:g}")
    check_lengths(distances)
    backlash, pole, at = mdeg(rig.backlash), lights[-1], HOME
    place_s = PLACE_S if rig.photodiode else EVEN_S
    planned = []
    for name, members in groups.items():
        own = [light for light in members.lights if light.index != pole.index]
        poses = [(mdeg(light.theta), mdeg(light.phi)) for light in own]
        found = order_group(at, poses, len(members.monitors), rig.axes, backlash, place_s)
        names = iter(members.monitors)
        shots = tuple(
            Shot(next(names), "monitor", pole.index, 0.0, pose[1] / 1000)
            if k is None
            else Shot(own[k].name, "light", own[k].index, own[k].theta, own[k].phi)
            for k, pose in found
        )
        planned.append(Group(name, tuple(light.index for light in members.lights), shots))
        at = found[-1][1]
    planned.append(Group(CALIBRATION, (), _calibration_shots(pole.index)))
    if views:
        planned.append(Group(VIEWS, (), tuple(order_views(views, rig.axes))))
    every = [shot for group in planned for shot in group.shots]
    try:
        for shot in every:
            check_pose(Identity("", rig.axes), pose_of(shot))
        travel = shots_time(every, rig.axes, backlash)
    except LimitError as error:
        raise InputError(str(error)) from None
    bracket = bracket_time(exposures_s)
    return Plan(
        fabric,
        kind,
        tuple(float(exposure) for exposure in exposures_s),
        tuple(lights),
        tuple(planned),
        duration_s=round(len(every) * shot_time(exposures_s) + travel, 3),
        light_dose_s=round(bracket * sum(shot.kind in LIT for shot in every), 3),
        lamp_mm=distances.lamp_mm,
        field_mm=distances.field_mm,
        camera_mm=distances.camera_mm,
        backlash=float(rig.backlash),
    )


def bracket_time(exposures_s: Sequence[float]) -> float:
    """Return the seconds of a bracket, in which the shutter of the lamp is open."""
    return sum(exposures_s) + CAMERA_S * len(exposures_s)


def shot_time(exposures_s: Sequence[float]) -> float:
    """Return the seconds of a shot: the rest of the arm, the bracket, and the fetching of its frames."""
    return SETTLE_S + bracket_time(exposures_s) + FETCH_S * len(exposures_s)


def rig_light(index: int, theta: float, phi: float, lamp_mm: float | None, cell: tuple[int, int] | None) -> PlanLight:
    """Return a light of the rig's lamp at (θ, φ) in degrees, which stands in the cell (iθ, iφ) of a grid."""
    vector = _vector(direction(math.radians(theta), math.radians(phi)).tolist(), 12)
    position = None if lamp_mm is None else _vector([v * lamp_mm for v in vector], 6)
    return PlanLight(index, direction_name(theta, phi), theta, phi, vector, cell, position)


def direction_name(theta: float, phi: float) -> str:
    """Return the name of a direction, such as ``t05_p120``, or ``t02-5_p007-5`` where a degree is too coarse."""
    words = []
    for letter, width, angle in (("t", 2, theta), ("p", 3, phi)):
        whole, _, fraction = f"{abs(angle):.3f}".rstrip("0").partition(".")
        words.append(f"{letter}{'-' if angle < 0 else ''}{int(whole):0{width}d}{fraction and '-' + fraction}")
    return "_".join(words)


def _vector(values: list[float], digits: int) -> Vector:
    x, y, z = (round(v, digits) + 0.0 for v in values)
    return x, y, z


def _calibration_shots(pole: int) -> tuple[Shot, ...]:
    """Return shots of the calibration's subjects, then of the fabric at θ = 0, which relates them to the monitors."""
    return (
        Shot("dark", "dark", None, 0.0, 0.0),
        Shot("white", "white", None, 0.0, 0.0),
        Shot("chart", "chart", None, 45.0, 0.0),
        *(Shot(f"monitor_c{k}", "monitor", pole, 0.0, 0.0) for k in range(1, CALIBRATION_MONITORS + 1)),
    )
