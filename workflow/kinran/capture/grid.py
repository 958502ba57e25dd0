"""The rig's grid of directions as a plan: θ = 0, 5, …, 80 and 72 meridians in the paper."""

import math
from collections.abc import Sequence

from kinran.base.distances import UNKNOWN, Distances
from kinran.base.files import InputError
from kinran.capture.assembly import CALIBRATION, LARGEST_GROUP, RIG, Members, Rig, assemble, direction_name, rig_light
from kinran.data.capture_plan import Plan, PlanLight
from kinran.data.shards import SHARD
from kinran.rig.motion import AXES

SAME = 1e-6
"""Part of a step of the grid within which a direction is one of it."""


def group_names(thetas: Sequence[float], phis: int, meridians: int = 4) -> list[str]:
    """Return the names of the groups of a grid, the calibration last.

    Parameters
    ----------
    thetas
        Polar angles in degrees, 0 among them.
    phis
        Number of meridians, evenly spread from φ = 0.
    meridians
        Meridians in a group.

    Raises
    ------
    InputError
        The grid cannot be cut into groups of whole shards.
    """
    return [*group_lights(thetas, phis, meridians), CALIBRATION]


def group_lights(thetas: Sequence[float], phis: int, meridians: int = 4) -> dict[str, range]:
    """Return the indices of the lights of each group of a grid; the last group also has the light at θ = 0.

    Parameters and errors are those of `group_names`.
    """
    _check_grid(thetas, phis, meridians)
    oblique = len(thetas) - 1
    starts = range(0, phis, meridians)
    if len(starts) > 1 and oblique * meridians % SHARD:
        good = SHARD // math.gcd(oblique, SHARD)
        raise InputError(
            f"{meridians} meridians of {oblique} directions are no multiple of {SHARD} lights;"
            f" put a multiple of {good} meridians in a group"
        )
    width = max(2, len(str(len(starts) - 1)))
    return {
        f"{i:0{width}d}": range(first * oblique, min(first + meridians, phis) * oblique + (first == starts[-1]))
        for i, first in enumerate(starts)
    }


def plan_grid(
    fabric: str,
    thetas: Sequence[float],
    phis: int,
    exposures_s: Sequence[float],
    meridians: int = 4,
    distances: Distances = UNKNOWN,
    rig: Rig = RIG,
) -> Plan:
    """Plan a grid of directions (Takeda2008, §4: θ = 0, 5, …, 80 and 72 meridians).

    Every direction with θ > 0 is one light, counted along one meridian after the other. θ = 0 is a single
    light, the last, which each group shoots once for each of its meridians: these are the monitors.

    Parameters
    ----------
    fabric
        Name of the fabric.
    thetas, phis, meridians
        Polar angles, number of meridians, and meridians in a group, as in `group_names`.
    exposures_s
        Exposure times of a bracket in seconds.
    distances
        Distances of lamp and camera from the field's centre, and width of the field that the camera sees.
    rig
        What is known of the rig.

    Raises
    ------
    InputError
        A value is out of range, or the grid cannot be cut into groups of whole shards.
    """
    owned = group_lights(thetas, phis, meridians)
    lights = _lights(sorted(float(theta) for theta in thetas), phis, distances.lamp_mm)
    groups = {
        name: Members(
            [lights[i] for i in owned[name]], [_monitor(p) for p in range(first, min(first + meridians, phis))]
        )
        for name, first in zip(owned, range(0, phis, meridians), strict=True)
    }
    return assemble(fabric, "grid", exposures_s, lights, groups, distances, rig)


def find_shots(thetas: Sequence[float], phis: int, meridians: int, theta: float, phi: float) -> list[tuple[str, str]]:
    """Return group and name of the shot of a direction in degrees; none where the grid does not have it.

    θ = 0 at the φ of a meridian is the monitor of this meridian, wherever the arm stands for it.
    """
    place = phi * phis / 360
    if theta not in thetas or not 0 <= place < phis or abs(place - round(place)) > SAME:
        return []
    group = list(group_lights(thetas, phis, meridians))[round(place) // meridians]
    return [(group, direction_name(theta, 360 * round(place) / phis) if theta else _monitor(round(place)))]


def _monitor(meridian: int) -> str:
    return f"monitor_{meridian + 1}"


def _check_grid(thetas: Sequence[float], phis: int, meridians: int) -> None:
    high = AXES[0].high / 1000
    if len(set(thetas)) != len(thetas) or len(thetas) < 2 or not all(0 <= t < high for t in thetas):
        raise InputError(f"thetas {list(thetas)}: give different angles from 0 to under {high:g} degrees")
    if 0 not in thetas:
        raise InputError(f"thetas {list(thetas)}: add 0, whose repeats watch the lamp")
    if not 1 <= phis <= 360:
        raise InputError(f"phis {phis}: give a number of meridians from 1 to 360")
    most = LARGEST_GROUP // (len(thetas) - 1)
    if not 1 <= meridians <= max(most, 1):
        raise InputError(f"meridians {meridians}: a group has at most {LARGEST_GROUP} lights; give 1 to {most}")


def _lights(thetas: list[float], phis: int, lamp_mm: float | None) -> list[PlanLight]:
    grid = [(t, p) for p in range(phis) for t in range(1, len(thetas))] + [(0, 0)]
    return [rig_light(i, thetas[t], 360 * p / phis, lamp_mm, (t, p)) for i, (t, p) in enumerate(grid)]
