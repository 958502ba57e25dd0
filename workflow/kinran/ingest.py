"""Take photographs with known lights (a folder with a `.lp` file) into the layout of a capture."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from kinran import encoding, photographs
from kinran.files import InputError, check_name, sha256, write_json
from kinran.lights import Light, lp_file, read_lp
from kinran.plans import LIST_GROUP, Group, Plan, PlanLight, Shot, list_group_names, read_plan, write_plan
from kinran.radiance.exif import exif_seconds
from kinran.radiance.exposures import time_in_name
from kinran.radiance.raw import is_raw


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--folder", type=Path, required=True, help="folder of the photographs and their .lp")
    parser.add_argument("--fabric", help="name of the fabric (to write its plan)")
    parser.add_argument("--encoding", default="srgb", help="srgb, linear or gamma:EXPONENT")
    parser.add_argument("--crop", default="", metavar="X,Y,W,H", help="part to use, from the top left")
    parser.add_argument("--holdout", type=int, default=0, help="every how many lights one is held out")
    parser.add_argument("--plan", type=Path, help="plan of the capture, to write the manifest of --group")
    parser.add_argument("--group", help="group of the plan to write")
    parser.add_argument("out", type=Path, help="plan (.json), or the group's manifest (.json)")


def main(args: argparse.Namespace) -> None:
    """Write the plan of the set or, given a plan and a group, that group's manifest."""
    if args.plan:
        write_json(args.out, manifest(args.plan, args.group, args.folder))
        return
    lights = inspect(args.folder, args.encoding, args.crop, args.holdout)
    times = exposures(photographs.find_frames(args.folder, lights))
    write_plan(args.out, plan(args.fabric, lights, args.encoding, args.crop, times))


def inspect(folder: Path, encoded: str, crop_text: str, holdout: int) -> list[Light]:
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


def plan(fabric: str, lights: list[Light], encoded: str, crop: str, exposures_s: tuple[float, ...] = (1.0,)) -> Plan:
    """Plan of a set in the order of its `.lp` file."""
    entries = tuple(
        PlanLight(
            index,
            light.name,
            round(math.degrees(math.acos(min(light.direction[2], 1.0))), 6),
            round(math.degrees(math.atan2(light.direction[1], light.direction[0])) % 360, 6),
            light.direction,
        )
        for index, light in enumerate(lights)
    )
    groups = []
    for k, name in enumerate(list_group_names(len(lights))):
        inside = entries[k * LIST_GROUP : (k + 1) * LIST_GROUP]
        shots = tuple(Shot(light.name, "light", light.index, light.theta, light.phi) for light in inside)
        groups.append(Group(name, tuple(light.index for light in inside), shots))
    return Plan(check_name(fabric, "fabric"), "list", exposures_s, entries, tuple(groups), encoding=encoded, crop=crop)


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
