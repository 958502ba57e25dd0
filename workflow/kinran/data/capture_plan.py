"""The plan of a capture: its lights, and its shots in groups and in order."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import msgspec

from kinran.base.files import InputError, check_name, fitted, read_json, write_json
from kinran.data.shards import SHARD

VERSION = 1
"""Version of a plan's file; another one is refused."""
LIST_GROUP = 64
"""Lights in a group of a list of photographs: eight whole shards."""

Kind = Literal["light", "monitor", "view", "dark", "white", "chart"]
RigKind = Literal["grid", "directions"]
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class PlanLight:
    """One light of the plan.

    Attributes
    ----------
    index
        Index of the light in the radiance stack.
    name
        Name of its shot.
    theta, phi
        Polar angle and azimuth in degrees that the rig moves to; φ in [0, 360).
    direction
        Unit vector at the field's centre, away from the surface.
    grid
        (iθ, iφ) in the plan's grid; None in a list, but (0, 0) for the light at θ = 0 that a rig repeats.
    position_mm
        Position of the lamp in millimetres from the field's centre; None when unknown.
    intensity
        Light of the lamp in R, G, B, in any unit; None where all are alike.
    """

    index: int
    name: str
    theta: float
    phi: float
    direction: Vector
    grid: tuple[int, int] | None = None
    position_mm: Vector | None = None
    intensity: Vector | None = None


@dataclass(frozen=True)
class Shot:
    """One shot of the plan: a bracket to be taken.

    Attributes
    ----------
    shot
        Name, unique in the plan.
    kind
        ``light``, ``monitor`` (a repeat of the light at θ = 0), ``view`` (of the camera from the side, and the front
        view that goes with it), ``dark``, ``white`` or ``chart``.
    light
        Index of the shot's light in the radiance stack; None for shots that are no part of it.
    theta, phi
        Pose of the light arm in degrees.
    camera
        Pose (θ, φ) of the camera arm in degrees; None where it stays on N.
    """

    shot: str
    kind: Kind
    light: int | None
    theta: float
    phi: float
    camera: tuple[float, float] | None = None


@dataclass(frozen=True)
class Group:
    """A group of shots that are taken one after the other: one manifest, one merge job.

    Attributes
    ----------
    name
        ``00``, ``01``, …, ``calibration`` or ``views``.
    lights
        Indices of the lights whose shards of the stack this group writes.
    shots
        Shots in the order in which they are taken.
    """

    name: str
    lights: tuple[int, ...]
    shots: tuple[Shot, ...]


@dataclass(frozen=True)
class Plan:
    """The plan of a capture.

    Attributes
    ----------
    fabric
        Name of the fabric.
    kind
        ``grid`` or ``directions`` (a list of them) for the rig, ``list`` for photographs.
    exposures_s
        Nominal exposure times of a bracket in seconds.
    lights
        Lights in the order of their indices.
    groups
        Groups of shots.
    duration_s, light_dose_s
        Predicted duration, and time under the open shutter, in seconds; None for photographs.
    lamp_mm, field_mm, camera_mm
        Distances of `kinran.base.distances.Distances`; None when unknown.
    encoding, crop
        Encoding of photographs, and the part X,Y,W,H of them that is used; empty for all.
    axis_mm
        Point (X, Y) in which the camera's axis meets the fabric, in millimetres from the middle of the crop; None for
        the middle itself.
    average
        Pixels of photographs, along a side, of which one texel is the mean.
    mask, mask_sha256
        File of the mask of photographs, and its SHA-256; empty without one.
    backlash
        Degrees that an axis of the rig goes beyond a target which it would reach from below, to take up its play.
    """

    fabric: str
    kind: RigKind | Literal["list"]
    exposures_s: tuple[float, ...]
    lights: tuple[PlanLight, ...]
    groups: tuple[Group, ...]
    duration_s: float | None = None
    light_dose_s: float | None = None
    lamp_mm: float | None = None
    field_mm: float | None = None
    camera_mm: float | None = None
    encoding: str | None = None
    crop: str = ""
    axis_mm: tuple[float, float] | None = None
    average: int = 1
    mask: str = ""
    mask_sha256: str = ""
    backlash: float = 0.0

    @property
    def on_rig(self) -> bool:
        """Whether the rig shoots it; else it lists photographs."""
        return self.kind != "list"

    def group(self, name: str) -> Group:
        """Return the group of this name.

        Raises
        ------
        InputError
            The plan has no such group.
        """
        for group in self.groups:
            if group.name == name:
                return group
        names = ", ".join(group.name for group in self.groups)
        raise InputError(f"group '{name}' is not in the plan of {self.fabric}; it has {names}")

    @property
    def sha256(self) -> str:
        """SHA-256 of the plan's content, in hexadecimal."""
        text = json.dumps(_as_json(self), sort_keys=True, ensure_ascii=False, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class _Stamp:
    """Version and digest in the file of a plan."""

    version: int
    sha256: str


def write_plan(path: Path, plan: Plan) -> None:
    """Write a plan with its digest, atomically."""
    write_json(path, {**_as_json(plan), "sha256": plan.sha256})


def read_plan(path: Path) -> Plan:
    """Read and check a plan.

    Raises
    ------
    InputError
        The file is missing, of another version, edited, or inconsistent.
    """
    value = read_json(path)
    stamp = fitted(path, value, _Stamp, "a plan")
    if stamp.version != VERSION:
        raise InputError(f"{path}: plan version {stamp.version} is not {VERSION}; plan again")
    plan = fitted(path, value, Plan, "a plan")
    if stamp.sha256 != plan.sha256:
        raise InputError(f"{path}: its content does not match its sha256; do not edit a plan, make it again")
    check_name(plan.fabric, "fabric")
    check_plan(path, plan)
    return plan


def check_plan(path: Path, plan: Plan) -> None:
    """Check that a plan is consistent.

    Raises
    ------
    InputError
        A name is unsafe or stands twice, a light is missing, or a group is not made of whole shards.
    """
    if not plan.exposures_s or min(plan.exposures_s) <= 0:
        raise InputError(f"{path}: exposures {plan.exposures_s} are wrong; plan again")
    if [light.index for light in plan.lights] != list(range(len(plan.lights))):
        raise InputError(f"{path}: the lights are not numbered 0, 1, 2, …; plan again")
    owned = [index for group in plan.groups for index in group.lights]
    if sorted(owned) != list(range(len(plan.lights))):
        raise InputError(f"{path}: a light belongs to no group or to two; plan again")
    full = [group for group in plan.groups if group.lights]
    if any(len(group.lights) % SHARD for group in full[:-1]):
        raise InputError(f"{path}: a group before the last is not a multiple of {SHARD} lights; plan again")
    seen: set[str] = set()
    for group in plan.groups:
        check_name(group.name, f"{path}: group")
        for shot in group.shots:
            if plan.on_rig:
                check_name(shot.shot, f"{path}: shot")
            if shot.shot in seen or shot.kind not in get_args(Kind):
                raise InputError(f"{path}: shot '{shot.shot}' stands twice or is of no known kind")
            if shot.light is not None and not 0 <= shot.light < len(plan.lights):
                raise InputError(f"{path}: shot '{shot.shot}' names light {shot.light}, which is not there")
            seen.add(shot.shot)


ABSENT = (("camera_mm", None), ("axis_mm", None), ("average", 1), ("mask", ""), ("mask_sha256", ""), ("backlash", 0.0))
"""Keys that a plan's file leaves out where they have these values."""


def _as_json(plan: Plan) -> dict[str, Any]:
    plan = msgspec.convert(asdict(plan), Plan)  # 600 is 600.0, as it will be when the plan is read
    value = {"version": VERSION, **asdict(plan)}
    for key, absent in ABSENT:
        if value[key] == absent:  # plans that were written without these keys keep their digests
            del value[key]
    for light in value["lights"]:
        if light["intensity"] is None:
            del light["intensity"]
    for shot in (shot for group in value["groups"] for shot in group["shots"]):
        if shot["camera"] is None:
            del shot["camera"]
    return value


def list_group_names(count: int) -> list[str]:
    """Return the names of the groups of a list of `count` lights."""
    return [f"{k:02d}" for k in range(math.ceil(count / LIST_GROUP))]
