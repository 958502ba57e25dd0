"""A sheet of directions as a plan: any lights, and side views, in groups that further rows leave as they are."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinran.base.distances import UNKNOWN, Distances
from kinran.base.files import InputError
from kinran.base.sheets import numbered_rows
from kinran.capture.assembly import CALIBRATION, LARGEST_GROUP, RIG, Members, Rig, assemble, direction_name, rig_light
from kinran.data.capture_plan import Plan, Shot
from kinran.data.shards import SHARD
from kinran.rig.motion import AXES, mdeg

COLUMNS = ("theta", "phi", "camera_theta", "camera_phi", "group")
"""Columns of a sheet; the first two are needed."""
LIGHTS_A_MONITOR = 16
"""Lights of a group for each of its monitors, as in a group of the paper's grid."""
LEAST_MONITORS = 2
"""Monitors of the smallest group, so that one of them can be saturated or shifted."""
FRONT = "front"
"""Name of the front view, by which `kinran register` finds it."""


@dataclass(frozen=True)
class Direction:
    """A direction (θ, φ) of the light in degrees, φ in [0, 360)."""

    theta: float
    phi: float


@dataclass(frozen=True)
class Directions:
    """The content of a sheet.

    Attributes
    ----------
    groups
        Directions of each group of lights by its name, θ = 0 left out.
    views
        Side views: the light's direction, and that of the camera in degrees.
    """

    groups: dict[str, list[Direction]]
    views: list[tuple[Direction, tuple[float, float]]]

    @property
    def group_names(self) -> list[str]:
        """Names of the groups, the calibration last."""
        return [*self.groups, CALIBRATION]

    @property
    def count(self) -> int:
        """Number of lights, with that at θ = 0."""
        return sum(map(len, self.groups.values())) + 1

    def find_shots(self, theta: float, phi: float) -> list[tuple[str, str]]:
        """Return group and name of the shots of a direction in degrees: at θ = 0 all monitors, else one or none."""
        if theta == 0:
            return [(name, shot) for name, own in self.groups.items() for shot in _monitors(name, len(own))]
        wanted = _mdeg(Direction(theta, phi % 360))
        return [
            (name, direction_name(each.theta, each.phi))
            for name, own in self.groups.items()
            for each in own
            if _mdeg(each) == wanted
        ]


def read_directions(path: Path) -> Directions:
    """Read a sheet with the columns ``theta`` and ``phi`` in degrees, between tabs or commas.

    Rows with ``camera_theta`` and ``camera_phi`` are side views. Without a column ``group``, every 64 rows are a group,
    and the last group has the rest; so rows that are added at the end leave full groups as they are.

    Raises
    ------
    InputError
        A cell is wrong, a direction stands twice, or the groups are not made of whole shards.
    """
    rows = numbered_rows(path, commas=True)
    if not rows:
        raise InputError(f"{path}: has no direction; add a header 'theta phi' and a row for each")
    names = rows[0][1].keys()
    if unknown := [name for name in names if name not in COLUMNS]:
        raise InputError(f"{path}: column '{unknown[0]}' is none of {', '.join(COLUMNS)}; rename it or take it out")
    if lacking := [name for name in COLUMNS[:2] if name not in names]:
        raise InputError(f"{path}: has no column '{lacking[0]}'; name it in the header")
    lights: list[tuple[int, int | None, Direction]] = []
    views: list[tuple[Direction, tuple[float, float]]] = []
    seen: dict[tuple[int, ...], int] = {}
    for line, row in rows:
        where = f"{path}: line {line}"
        theta = _angle(where, row, "theta", AXES[0].low / 1000, AXES[0].high / 1000)
        if theta == 90:
            raise InputError(f"{where}: theta 90 is the horizon; give less than 90 degrees")
        light = Direction(theta, _angle(where, row, "phi", -360, 360) % 360)
        camera = _camera(where, row)
        key = (*_mdeg(light), *(mdeg(angle) for angle in camera or ()))
        if key in seen:
            raise InputError(f"{where} has the direction of line {seen[key]} again; take one of them out")
        seen[key] = line
        if camera is not None:
            views.append((light, camera))
        elif light.theta:  # θ = 0 is what the monitors are
            lights.append((line, _group(where, row) if "group" in names else None, light))
    if not lights:
        raise InputError(f"{path}: has no direction of the light with theta over 0; add some")
    return Directions(_in_groups(path, lights), views)


def plan_directions(
    fabric: str,
    directions: Directions,
    exposures_s: Sequence[float],
    distances: Distances = UNKNOWN,
    rig: Rig = RIG,
) -> Plan:
    """Plan a list of directions.

    The lights have the order of the list, and θ = 0 is the last. Each group shoots it as a monitor, once for every 16
    of its lights, and at least twice.

    Parameters
    ----------
    fabric
        Name of the fabric.
    directions
        Lights in groups, and side views.
    exposures_s
        Exposure times of a bracket in seconds.
    distances
        Distances of lamp and camera from the field's centre, and width of the field that the camera sees.
    rig
        What is known of the rig.

    Raises
    ------
    InputError
        A value is out of range, a pose is outside the limits, or the arms would meet.
    """
    owned = [(name, each) for name, own in directions.groups.items() for each in own]
    lamp_mm = distances.lamp_mm
    lights = [rig_light(i, each.theta, each.phi, lamp_mm, None) for i, (_, each) in enumerate(owned)]
    lights.append(rig_light(len(lights), 0.0, 0.0, lamp_mm, (0, 0)))
    groups, last = {}, list(directions.groups)[-1]
    for group, own in directions.groups.items():
        inside = [light for light, (name, _) in zip(lights, owned, strict=False) if name == group]
        groups[group] = Members(inside + lights[-1:] * (group == last), _monitors(group, len(own)))
    return assemble(fabric, "directions", exposures_s, lights, groups, distances, rig, _views(directions))


def _monitors(group: str, lights: int) -> list[str]:
    count = max(LEAST_MONITORS, math.ceil(lights / LIGHTS_A_MONITOR))
    return [f"monitor_{group}_{k}" for k in range(1, count + 1)]


def _views(directions: Directions) -> list[Shot]:
    """Return the front view, under the light of the first side view, and the side views; none where there is none."""
    shots = [
        Shot(f"view_{direction_name(*camera)}_under_{direction_name(light.theta, light.phi)}", "view", None,
             light.theta, light.phi, camera)
        for light, camera in directions.views
    ]  # fmt: skip
    first = [Shot(FRONT, "view", None, light.theta, light.phi, (0.0, 0.0)) for light, _ in directions.views[:1]]
    return first + shots


def _in_groups(path: Path, lights: list[tuple[int, int | None, Direction]]) -> dict[str, list[Direction]]:
    """Return the lights of each group by its name.

    Raises
    ------
    InputError
        The groups are not 0, 1, … in this order, or one of them is not made of whole shards.
    """
    groups: dict[str, list[Direction]] = {}
    number = 0
    for k, (line, given, light) in enumerate(lights):
        wanted = k // LARGEST_GROUP if given is None else given
        if wanted not in (number, number + 1 if groups else 0):
            raise InputError(
                f"{path}: line {line} is of group {wanted} after group {number}; number the groups 0, 1, … and keep"
                " the rows of a group together"
            )
        if wanted != number and len(groups[f"{number:02d}"]) % SHARD:
            raise InputError(
                f"{path}: group {number} has {len(groups[f'{number:02d}'])} directions, but every group before the"
                f" last needs a multiple of {SHARD}; move some, or add some"
            )
        number = wanted
        own = groups.setdefault(f"{number:02d}", [])
        own.append(light)
        if len(own) > LARGEST_GROUP:
            raise InputError(
                f"{path}: line {line} is number {len(own)} of group {number}; give at most {LARGEST_GROUP}"
            )
    return groups


def _group(where: str, row: dict[str, str]) -> int:
    if not row["group"].isdecimal():
        raise InputError(f"{where}: group '{row['group']}' is no whole number from 0")
    return int(row["group"])


def _camera(where: str, row: dict[str, str]) -> tuple[float, float] | None:
    given = [name for name in ("camera_theta", "camera_phi") if row.get(name)]
    if not given:
        return None
    if len(given) == 1:
        raise InputError(f"{where}: has {given[0]} alone; give camera_theta and camera_phi, or neither")
    theta, phi = (
        _angle(where, row, name, axis.low / 1000, axis.high / 1000) for name, axis in zip(given, AXES[2:], strict=True)
    )
    if theta == 0:
        raise InputError(
            f"{where}: camera_theta 0 is the front view, which is added; leave the camera empty for a light"
        )
    return theta, phi


def _angle(where: str, row: dict[str, str], name: str, low: float, high: float) -> float:
    try:
        value = round(float(row[name]), 3) + 0.0  # whole millidegrees, as the rig is told
    except ValueError:
        raise InputError(f"{where}: {name} '{row[name]}' is no number; give degrees") from None
    if not low <= value <= high:
        raise InputError(f"{where}: {name} {row[name]} is outside {low:g} to {high:g}; give degrees")
    return value


def _mdeg(light: Direction) -> tuple[int, int]:
    return mdeg(light.theta), mdeg(light.phi) % 360_000 if light.theta else 0
