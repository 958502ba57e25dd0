"""Take photographs with known lights (a folder with a `.lp` file) into the layout of a capture."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from kinran import encoding, photographs
from kinran.files import InputError, check_name, sha256, write_json
from kinran.geometry import Distances, crop_centre, seen_from, unit
from kinran.lights import LpLight, lp_file, read_lp
from kinran.plans import LIST_GROUP, Group, Plan, PlanLight, Shot, list_group_names, read_plan, write_plan
from kinran.radiance.exif import exif_seconds
from kinran.radiance.exposures import time_in_name
from kinran.radiance.raw import is_raw

UNIT = 0.02
"""Vectors whose lengths are further than this from 1 may be positions."""


def add_distances(parser: argparse.ArgumentParser) -> None:
    """Arguments that say where lamps and camera stand."""
    help_ = "length of 1 in the .lp: the dome's radius, or 1 where it holds positions in mm; without it, directions"
    parser.add_argument("--lamp-mm", type=float, metavar="MM", help=help_)
    parser.add_argument("--field-mm", type=float, metavar="MM", help="width of a whole photograph on the fabric")
    help_ = "from the fabric to the lens; without it, seen along the normal everywhere"
    parser.add_argument("--camera-mm", type=float, metavar="MM", help=help_)


def distances(args: argparse.Namespace) -> Distances:
    """Distances that the arguments of `add_distances` give.

    Raises
    ------
    InputError
        One is no length, or the field's width is missing, without which the others say nothing.
    """
    given = Distances(args.lamp_mm, args.field_mm, args.camera_mm)
    for name, value in (("lamp", given.lamp_mm), ("field", given.field_mm), ("camera", given.camera_mm)):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(f"--{name}-mm {value:g}: give a length over 0 mm")
    if given.field_mm is None and (given.lamp_mm or given.camera_mm):
        name = "lamp" if given.lamp_mm else "camera"
        raise InputError(f"--{name}-mm: says something only beside the width of a photograph; give --field-mm as well")
    return given


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--folder", type=Path, required=True, help="folder of the photographs and their .lp")
    parser.add_argument("--fabric", help="name of the fabric (to write its plan)")
    parser.add_argument("--encoding", default="srgb", help="srgb, linear or gamma:EXPONENT")
    parser.add_argument("--crop", default="", metavar="X,Y,W,H", help="part to use, from the top left")
    parser.add_argument("--holdout", type=int, default=0, help="every how many lights one is held out")
    add_distances(parser)
    parser.add_argument("--plan", type=Path, help="plan of the capture, to write the manifest of --group")
    parser.add_argument("--group", help="group of the plan to write")
    parser.add_argument("out", type=Path, help="plan (.json), or the group's manifest (.json)")


def main(args: argparse.Namespace) -> None:
    """Write the plan of the set or, given a plan and a group, that group's manifest."""
    if args.plan:
        write_json(args.out, manifest(args.plan, args.group, args.folder))
        return
    lights = inspect(args.folder, args.encoding, args.crop, args.holdout)
    if said := remark_on_lengths(lights, args.lamp_mm):
        print(said, file=sys.stderr)
    found = photographs.find_frames(args.folder, lights)
    size = photographs.size(found[lights[0].name][0])
    write_plan(args.out, plan(args.fabric, lights, args.encoding, args.crop, exposures(found), distances(args), size))


def inspect(folder: Path, encoded: str, crop_text: str, holdout: int) -> list[LpLight]:
    """Check a whole set before anything is written: lights, files, sizes, crop, and that each image decodes.

    Raises
    ------
    InputError
        What is wrong first.
    """
    lights = read_lp(lp_file(folder))
    coder = encoding.parse(encoded)
    crop = photographs.parse_crop(crop_text)
    held = held_out_count(len(lights), holdout)
    if len(lights) - held < 4:
        raise InputError(
            f"{folder}: {len(lights)} lights with {held} held out leave {len(lights) - held} to fit; 4 are needed"
        )
    if holdout and not held:
        raise InputError(
            f"{folder}: no light of {len(lights)} is left to hold out when every {holdout}th is; give --holdout 0"
        )
    found = photographs.find_frames(folder, lights)
    exposures(found)
    first, paths = found[lights[0].name][0], [path for frames in found.values() for path in frames]
    sizes = {path: photographs.size(path) for path in paths}
    for path, size in sizes.items():
        if size != sizes[first]:
            raise InputError(
                f"{path}: is {size[0]}x{size[1]} but {first.name} is {sizes[first][0]}x{sizes[first][1]};"
                " all photographs of a set have one size"
            )
    for k, path in enumerate(paths):
        if not is_raw(path):  # LibRaw has looked into those
            photographs.read(path, coder, crop)
        if sys.stderr.isatty():
            print(f"\rchecking photograph {k + 1} of {len(paths)}", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return lights


def remark_on_lengths(lights: list[LpLight], lamp_mm: float | None) -> str:
    """What is to be said where the vectors look like positions but are taken for directions; else empty."""
    lengths = [light.length for light in lights]
    if lamp_mm or max(abs(length - 1) for length in lengths) < UNIT:
        return ""
    return (
        f"the .lp's vectors are {min(lengths):.4g} to {max(lengths):.4g} long and taken for directions; if they are"
        " positions, give --lamp-mm (millimetres of a length of 1) and --field-mm"
    )


def exposures(found: dict[str, list[Path]]) -> tuple[float, ...]:
    """Nominal exposure times of a set's brackets, longest first; 1 for single photographs.

    Raises
    ------
    InputError
        Single RAW files, or a bracket's time is not known, stands twice, or is another light's.
    """
    times: set[float] = set()
    for name, frames in found.items():
        if len(frames) == 1 and is_raw(frames[0]):
            raise InputError(f"{frames[0]}: is a single RAW file; give brackets of RAW, or developed photographs")
        if (len(frames) > 1) != (len(next(iter(found.values()))) > 1):
            raise InputError(f"{frames[0]}: light '{name}' has {len(frames)} image(s), the first one more or fewer")
        own = frame_seconds(frames)
        if len(set(own)) < len(own):
            raise InputError(f"{frames[0]}: the bracket of light '{name}' has an exposure time twice; keep one of them")
        times |= set(own)
    return tuple(sorted(times, reverse=True))


def frame_seconds(frames: list[Path]) -> list[float]:
    """Nominal exposure time of each frame of a light, of EXIF or of its name; 1 for a single photograph."""
    if len(frames) == 1:
        return [1.0]
    seconds = [round(exif_seconds(path) or time_in_name(path.stem), 9) for path in frames]
    for path, value in zip(frames, seconds, strict=True):
        if not value:
            raise InputError(f"{path}: has no exposure time in its EXIF; rename it to {path.stem}_1-250s{path.suffix}")
    return seconds


def held_out_count(lights: int, every: int) -> int:
    """How many of a list of lights are held out."""
    return sum(index % every == every // 2 for index in range(lights)) if every else 0


def plan(
    fabric: str,
    lights: list[LpLight],
    encoded: str,
    crop: str,
    exposures_s: tuple[float, ...] = (1.0,),
    measured: Distances | None = None,
    size: tuple[int, int] = (1, 1),
) -> Plan:
    """Plan of a set in the order of its `.lp` file.

    Parameters
    ----------
    fabric
        Name.
    lights
        Of the `.lp`: as they are seen from the middle of a whole photograph.
    encoded, crop
        Of the photographs.
    exposures_s
        Of a bracket; 1 for single photographs.
    measured
        Distances; with them the lights stand where they are seen from the middle of the crop.
    size
        Width and height of a whole photograph.
    """
    measured, part = measured or Distances(), photographs.parse_crop(crop)
    centre, field_mm = (0.0, 0.0), measured.field_mm
    if part and field_mm:
        centre = crop_centre((part.x, part.y, part.width, part.height), size, field_mm)
        field_mm *= part.width / size[0]
    entries = tuple(_place(index, light, measured.lamp_mm, centre) for index, light in enumerate(lights))
    groups = []
    for k, name in enumerate(list_group_names(len(lights))):
        inside = entries[k * LIST_GROUP : (k + 1) * LIST_GROUP]
        shots = tuple(Shot(light.name, "light", light.index, light.theta, light.phi) for light in inside)
        groups.append(Group(name, tuple(light.index for light in inside), shots))
    return Plan(
        check_name(fabric, "fabric"),
        "list",
        exposures_s,
        entries,
        tuple(groups),
        field_mm=field_mm,
        camera_mm=measured.camera_mm,
        encoding=encoded,
        crop=crop,
        axis_mm=(-centre[0], -centre[1]) if measured.camera_mm and part else None,
    )


def _place(index: int, light: LpLight, lamp_mm: float | None, centre: tuple[float, float]) -> PlanLight:
    """A light as it is seen from the middle of the crop; as the `.lp` has it where its distance is not known."""
    position, direction = None, light.direction
    if lamp_mm:
        reach = lamp_mm * light.length
        position = seen_from((reach * direction[0], reach * direction[1], reach * direction[2]), centre)
        direction = unit(position)
    theta = math.degrees(math.acos(min(direction[2], 1.0)))
    phi = math.degrees(math.atan2(direction[1], direction[0])) % 360
    return PlanLight(index, light.name, round(theta, 6), round(phi, 6), direction, position_mm=position)


def manifest(plan_file: Path, name: str, folder: Path) -> dict[str, Any]:
    """Manifest of a group: the photographs where they lie, with their digests."""
    planned = read_plan(plan_file)
    group = planned.group(name)
    found = photographs.find_frames(folder, list(read_lp(lp_file(folder))))
    shots = []
    for shot in group.shots:
        paths = [path.resolve() for path in found[shot.shot]]
        seconds = [None] if len(paths) == 1 else frame_seconds(paths)
        frames = [
            {"file": str(path), "sha256": sha256(path), "bytes": path.stat().st_size, "exposure_s": time}
            for path, time in zip(paths, seconds, strict=True)
        ]
        shots.append(
            {
                "shot": shot.shot,
                "kind": shot.kind,
                "light": shot.light,
                "revision": 0,
                "pose_mdeg": None,
                "photodiode": None,
                "time_s": None,
                "frames": frames,
            }
        )
    return {
        "version": 1,
        "fabric": planned.fabric,
        "group": name,
        "plan_sha256": planned.sha256,
        "kind": planned.kind,
        "lights": list(group.lights),
        "shots": shots,
    }
