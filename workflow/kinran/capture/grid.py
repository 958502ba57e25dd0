"""The rig's grid of directions as a plan: groups of whole shards, the order of their shots, duration and light dose."""

import itertools
import math
from collections.abc import Sequence

from kinran.base.distances import UNKNOWN, Distances, check_lengths
from kinran.base.files import InputError, check_name
from kinran.base.frames import direction
from kinran.data.capture_plan import Group, Plan, PlanLight, Shot, Vector
from kinran.data.shards import SHARD
from kinran.rig.motion import AXES, SETTLE_S, move_time

CAMERA_S = 1.0
"""Seconds that a camera needs for a frame besides its exposure: libgphoto2 alone takes 0.95 s (0.10 to set the shutter
time, 0.71 to trigger, the rest to notice and fetch the frame), timed with an emulated EOS without delays."""

LARGEST_GROUP = 64
"""Most lights of a group: eight shards, so that a group is merged, or repeated, in minutes."""
CALIBRATION = "calibration"
"""Name of the group of calibration shots."""
CALIBRATION_MONITORS = 4
"""Shots of the fabric at θ = 0 in the group of the white plate, as many as in a group of four meridians: their mean
halves the noise of the ratio between fabric and plate."""


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
) -> Plan:
    """Plan a grid of directions (Takeda2008, §4: θ = 0, 5, …, 80 and 72 meridians).

    Every direction with θ > 0 is one light, counted along one meridian after the other. θ = 0 is a single
    light, the last, which is shot once for each meridian: these monitors are spread over each group.

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

    Raises
    ------
    InputError
        A value is out of range, or the grid cannot be cut into groups of whole shards.
    """
    check_name(fabric, "fabric")
    if not exposures_s or not all(math.isfinite(e) and 0 < e <= 60 for e in exposures_s):
        raise InputError(f"exposures {list(exposures_s)}: give seconds between 0 and 60")
    check_lengths(distances)
    owned = group_lights(thetas, phis, meridians)
    lights = _lights(sorted(float(theta) for theta in thetas), phis, distances.lamp_mm)
    groups = [
        Group(
            name,
            tuple(owned[name]),
            tuple(_group_shots(lights, owned[name], first, min(first + meridians, phis))),
        )
        for name, first in zip(owned, range(0, phis, meridians), strict=True)
    ]
    groups.append(Group(CALIBRATION, (), _calibration_shots(lights[-1].index)))
    bracket = sum(exposures_s) + CAMERA_S * len(exposures_s)
    shots = [shot for group in groups for shot in group.shots]
    return Plan(
        fabric,
        "grid",
        tuple(float(exposure) for exposure in exposures_s),
        tuple(lights),
        tuple(groups),
        duration_s=round(len(shots) * (bracket + SETTLE_S) + _travel(shots), 3),
        light_dose_s=round(bracket * sum(shot.kind in ("light", "monitor") for shot in shots), 3),
        lamp_mm=distances.lamp_mm,
        field_mm=distances.field_mm,
        camera_mm=distances.camera_mm,
    )


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
    lights = []
    for index, (t, p) in enumerate(grid):
        theta, phi = thetas[t], 360 * p / phis
        vector = _vector(direction(math.radians(theta), math.radians(phi)).tolist(), 12)
        position = None if lamp_mm is None else _vector([v * lamp_mm for v in vector], 6)
        lights.append(PlanLight(index, _name(theta, phi), theta, phi, vector, (t, p), position))
    return lights


def _name(theta: float, phi: float) -> str:
    """Return a light's name, such as ``t05_p120``, or ``t02-5_p007-5`` where a degree is too coarse."""
    words = []
    for letter, width, angle in (("t", 2, theta), ("p", 3, phi)):
        whole, _, fraction = f"{angle:.3f}".rstrip("0").partition(".")
        words.append(f"{letter}{int(whole):0{width}d}{fraction and '-' + fraction}")
    return "_".join(words)


def _vector(values: list[float], digits: int) -> Vector:
    x, y, z = (round(v, digits) + 0.0 for v in values)
    return x, y, z


def _group_shots(lights: list[PlanLight], own: range, first: int, last: int) -> list[Shot]:
    """Return the shots of meridians `first` to `last` in the quicker of two serpentines, with monitors spread in it."""
    pole = lights[-1]
    directions = [Shot(lights[i].name, "light", i, lights[i].theta, lights[i].phi) for i in own if i != pole.index]
    inner_phi = _serpentine(directions, rows="theta")
    inner_theta = _serpentine(directions, rows="phi")
    shots = min(inner_phi, inner_theta, key=_travel)
    phis = sorted({shot.phi for shot in directions})
    monitors = [Shot(f"monitor_{first + i + 1}", "monitor", pole.index, pole.theta, phi) for i, phi in enumerate(phis)]
    gaps = max(len(monitors) - 1, 1)
    for i in reversed(range(len(monitors))):
        shots.insert(round(i * len(directions) / gaps), monitors[i])
    return shots


def _serpentine(shots: list[Shot], rows: str) -> list[Shot]:
    """Return shots in rows of an equal angle (`rows`: ``theta`` or ``phi``), every second row backwards."""
    order: list[Shot] = []
    inner = "phi" if rows == "theta" else "theta"
    for i, row in enumerate(sorted({getattr(shot, rows) for shot in shots})):
        line = [shot for shot in shots if getattr(shot, rows) == row]
        order += sorted(line, key=lambda shot: getattr(shot, inner), reverse=i % 2 == 1)
    return order


def _travel(shots: Sequence[Shot]) -> float:
    """Return the seconds of all moves from the first shot to the last."""
    poses = [(1000 * shot.theta, 1000 * shot.phi) for shot in shots]
    return sum(move_time(a, b) for a, b in itertools.pairwise(poses))


def _calibration_shots(pole: int) -> tuple[Shot, ...]:
    """Return shots of the calibration's subjects, then of the fabric at θ = 0, which relates them to the monitors."""
    return (
        Shot("dark", "dark", None, 0.0, 0.0),
        Shot("white", "white", None, 0.0, 0.0),
        Shot("chart", "chart", None, 45.0, 0.0),
        *(Shot(f"monitor_c{k}", "monitor", pole, 0.0, 0.0) for k in range(1, CALIBRATION_MONITORS + 1)),
    )
