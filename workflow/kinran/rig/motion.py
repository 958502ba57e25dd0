"""The axes of the rig and the duration of their moves: trapezoid speed profiles, all axes arriving at once."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


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


AXES = (
    Axis("light θ", 0, 90_000, 10_000, 20_000),
    Axis("light φ", -10_000, 370_000, 30_000, 60_000),
    Axis("camera θ", -75_000, 75_000, 10_000, 20_000),
    Axis("camera φ", -360_000, 360_000, 30_000, 60_000),
)
"""Axes of the simulated rig, from which a plan's duration is computed, too; a real rig states its own limits (CONFIG).
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
