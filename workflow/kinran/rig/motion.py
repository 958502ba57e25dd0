"""The axes of the rig and how long they take: trapezoid speed profiles, all axes arriving at once."""

import math
from collections.abc import Sequence
from dataclasses import dataclass


def mdeg(degrees: float) -> int:
    """Degrees in millidegrees."""
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
"""The axes of the simulated rig, and what a plan's duration is computed with; a real rig states its own limits
(CONFIG). The paper gives no speeds."""
SETTLE_S = 0.2
"""Seconds that an arm rests before an exposure, for vibrations to die away. No measurement stands behind them."""
ON_TARGET_MDEG = 20
"""Distance in millidegrees from its target at which an axis may come to rest: a 250th of a step of the paper's grid."""


def travel_time(distance: float, speed: float, acceleration: float) -> float:
    """Seconds for one axis to travel `distance` from rest to rest."""
    distance = abs(distance)
    if distance <= speed**2 / acceleration:
        return 2 * math.sqrt(distance / acceleration)
    return distance / speed + speed / acceleration


def travelled(distance: float, speed: float, acceleration: float, seconds: float) -> float:
    """Fraction of `distance` covered after `seconds`, in [0, 1]."""
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
    """Seconds of a coordinated move between two poses in millidegrees, without settling."""
    return max(travel_time(b - a, axis.speed, axis.acceleration) for a, b, axis in zip(start, end, axes, strict=False))
