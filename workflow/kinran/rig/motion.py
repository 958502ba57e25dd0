"""The axes of the rig and the duration of their moves: trapezoid speed profiles, all axes arriving at once."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

Pose = tuple[int, int, int, int]
"""Light θ, light φ, camera θ, camera φ in millidegrees."""
CLEARANCE_MDEG = 8_000
"""Least angle in millidegrees between the light arm and the camera arm: made up."""
ON_NORMAL_MDEG = 1_000
"""Camera θ in millidegrees under which the camera rests on N, out of the light arm's reach."""
SWEPT_MDEG = 1_000
"""Step in millidegrees in which a path is looked at: an eighth of the arms' least distance."""


def mdeg(degrees: float) -> int:
    """Return degrees as whole millidegrees."""
    return round(1000 * degrees)


@dataclass(frozen=True)
class Axis:
    """One axis: soft limits in millidegrees, top speed in mdeg/s, acceleration in mdeg/s²."""

    name: str
    low: int
    high: int
    speed: int
    acceleration: int


Four = tuple[Axis, Axis, Axis, Axis]

AXES: Four = (
    Axis("light θ", 0, 90_000, 10_000, 20_000),
    Axis("light φ", -10_000, 370_000, 30_000, 60_000),
    Axis("camera θ", -75_000, 75_000, 10_000, 20_000),
    Axis("camera φ", -360_000, 360_000, 30_000, 60_000),
)
"""Axes of the simulated rig, and of a plan for a rig that has not said its own (CONFIG, or `rig` in the config).
They are made up: the paper gives no speeds."""
SETTLE_S = 0.2
"""Seconds that an arm rests before an exposure, for vibrations to die away. No measurement stands behind them."""
ON_TARGET_MDEG = 20
"""Largest distance in millidegrees from its target at which an axis may rest: a 250th of a step of the paper's grid."""


def travel_time(distance: float, speed: float, acceleration: float) -> float:
    """Return the seconds of one axis for `distance` in mdeg from rest to rest, at mdeg/s and mdeg/s²."""
    distance = abs(distance)
    if distance <= speed**2 / acceleration:
        return 2 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


def travelled(distance: float, speed: float, acceleration: float, seconds: float) -> float:
    """Return the fraction of `distance` that is covered after `seconds`, in [0, 1]; units as in `travel_time`."""
    total = travel_time(distance, speed, acceleration)
    if seconds >= total:
        return 1.0
    distance = abs(distance)
    ramp = min(total / 2, speed / acceleration)
    left = total - seconds
    if seconds < ramp:
        return acceleration * seconds**2 / 2 / distance
    if left < ramp:
        return 1 - acceleration * left**2 / 2 / distance
    return (acceleration * ramp**2 / 2 + speed * (seconds - ramp)) / distance


def move_time(start: Sequence[float], end: Sequence[float], axes: Sequence[Axis] = AXES) -> float:
    """Return the seconds of a coordinated move between two poses in millidegrees, without settling."""
    return max(travel_time(b - a, axis.speed, axis.acceleration) for a, b, axis in zip(start, end, axes, strict=False))


def approach(
    start: Sequence[int], target: Sequence[int], backlash: int, axes: Sequence[Axis] = AXES
) -> list[tuple[int, ...]]:
    """Return the poses of a move whose axes all arrive from above, so that their play is always on the same side.

    An axis that would come from below goes `backlash` beyond its target first, as far as its limit lets it, while the
    others go to their targets at once. From above, θ = 0 is reached like any other angle, although the axis ends there.

    Parameters
    ----------
    start, target
        Poses of the two or four axes that move, in millidegrees.
    backlash
        Distance in millidegrees that takes up the play; 0 for a direct move.
    axes
        Axes of the rig.

    Returns
    -------
    list
        Poses to move to, the target last.
    """
    via = tuple(
        max(min(end + backlash, axis.high), end) if end - begin > ON_TARGET_MDEG else end
        for begin, end, axis in zip(start, target, axes, strict=False)
    )
    return [tuple(target)] if via == tuple(target) else [via, tuple(target)]


def with_motion(axes: Four, speeds: Sequence[float | None] = (), accelerations: Sequence[float | None] = ()) -> Four:
    """Return axes with other top speeds in deg/s and accelerations in deg/s²; None leaves an axis as it is."""
    changed = list(axes)
    for i, speed in enumerate(speeds):
        changed[i] = changed[i] if speed is None else replace(changed[i], speed=mdeg(speed))
    for i, acceleration in enumerate(accelerations):
        changed[i] = changed[i] if acceleration is None else replace(changed[i], acceleration=mdeg(acceleration))
    a, b, c, d = changed
    return a, b, c, d


def clearance(pose: Sequence[float]) -> float:
    """Return the angle between the arms in millidegrees; infinite where the camera rests on N."""
    light_theta, light_phi, camera_theta, camera_phi = (math.radians(angle / 1000) for angle in pose)
    if abs(pose[2]) < ON_NORMAL_MDEG:
        return math.inf
    cosine = math.cos(light_theta) * math.cos(camera_theta)
    cosine += math.sin(light_theta) * math.sin(camera_theta) * math.cos(light_phi - camera_phi)
    return 1000 * math.degrees(math.acos(max(-1.0, min(1.0, cosine))))


def swept(start: Sequence[float], end: Sequence[float]) -> list[tuple[float, ...]]:
    """Return the poses of a coordinated move, both ends included, in steps of `SWEPT_MDEG` or less.

    All axes start and arrive at once, so that the path is straight in the four angles, whatever their speeds.
    """
    pairs = list(zip(start, end, strict=True))
    steps = max(1, math.ceil(max(abs(b - a) for a, b in pairs) / SWEPT_MDEG))
    return [tuple(a + (b - a) * k / steps for a, b in pairs) for k in range(steps + 1)]
