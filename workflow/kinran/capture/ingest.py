"""Use photographs with known lights as a capture: write its plan."""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.distances import crop_centre, seen_from, unit
from kinran.base.files import check_name, sha256
from kinran.capture.doubts import doubts
from kinran.capture.photograph_set import Known, PhotographSet, averaged, inspect, remark_on_lengths
from kinran.data.capture_plan import LIST_GROUP, Group, Plan, PlanLight, Shot, list_group_names, write_plan
from kinran.data.light import LpLight
from kinran.data.photographs import parse_crop

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    folder: Annotated[Path, "folder of the photographs"]


@dataclass(frozen=True, kw_only=True)
class Options(Known):
    fabric: Annotated[str, "name of the fabric"]
    holdout: Annotated[int, "every how many lights one is held out; 0: none"] = 0


def main(inputs: Inputs, out: Annotated[Path, "OUT", "plan of the capture (.json)"], options: Options) -> None:
    """Write the plan of a set."""
    found = inspect(inputs.folder, options, options.holdout)
    said = remark_on_lengths(found.lights, options.lamp_mm)
    planned = plan(options.fabric, found, options)
    for remark in (*found.remarks, *([said] if said else []), *doubts(found, planned)):
        log.warning(remark)
    write_plan(out, planned)


def plan(fabric: str, photographs: PhotographSet, known: Known) -> Plan:
    """Return the plan of a set, in the order of its `.lp` file.

    Parameters
    ----------
    fabric
        Name of the fabric.
    photographs
        The set.
    known
        Encoding, crop and distances of the set; with distances, lights are relative to the middle of the crop.
    """
    measured, part, lights = known.distances, parse_crop(known.crop), photographs.lights
    centre, field_mm = (0.0, 0.0), measured.field_mm
    if part and field_mm:
        centre = crop_centre((part.x, part.y, part.width, part.height), photographs.size, field_mm)
        field_mm *= part.width / photographs.size[0]
    entries = tuple(_place(index, light, measured.lamp_mm, centre) for index, light in enumerate(lights))
    groups = []
    for k, name in enumerate(list_group_names(len(lights))):
        inside = entries[k * LIST_GROUP : (k + 1) * LIST_GROUP]
        shots = tuple(Shot(light.name, "light", light.index, light.theta, light.phi) for light in inside)
        groups.append(Group(name, tuple(light.index for light in inside), shots))
    return Plan(
        check_name(fabric, "fabric"),
        "list",
        photographs.exposures_s,
        entries,
        tuple(groups),
        field_mm=field_mm,
        camera_mm=measured.camera_mm,
        encoding=known.encoding,
        crop=known.crop,
        axis_mm=(-centre[0], -centre[1]) if measured.camera_mm and part else None,
        average=averaged(part, photographs.size, known.max_mp),
        mask=str(photographs.mask.resolve()) if photographs.mask else "",
        mask_sha256=sha256(photographs.mask) if photographs.mask else "",
    )


def _place(index: int, light: LpLight, lamp_mm: float | None, centre: tuple[float, float]) -> PlanLight:
    """Return a light relative to the middle of the crop, or as in the `.lp` where its distance is unknown."""
    position, direction = None, light.direction
    if lamp_mm:
        reach = lamp_mm * light.length
        position = seen_from((reach * direction[0], reach * direction[1], reach * direction[2]), centre)
        direction = unit(position)
    theta = math.degrees(math.acos(min(direction[2], 1.0)))
    phi = math.degrees(math.atan2(direction[1], direction[0])) % 360
    return PlanLight(
        index,
        light.name,
        round(theta, 6),
        round(phi, 6),
        direction,
        position_mm=position,
        intensity=light.intensity,
    )
