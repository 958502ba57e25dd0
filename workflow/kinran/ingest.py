"""Take photographs with known lights (a folder with a `.lp` file) into the layout of a capture."""

import argparse
import math
import sys
from pathlib import Path
from typing import Any

from kinran import encoding, photographs
from kinran.files import InputError, check_name, sha256, write_json
from kinran.lights import Light, read_lp
from kinran.plans import Group, Plan, PlanLight, Shot, read_plan, write_plan

GROUP = 64
"""Lights in a group: eight whole shards of the stack."""


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
    write_plan(args.out, plan(args.fabric, lights, args.encoding, args.crop))


def group_names(count: int) -> list[str]:
    """Names of the groups of a set of `count` lights."""
    return [f"{k:02d}" for k in range(math.ceil(count / GROUP))]


def lp_file(folder: Path) -> Path:
    """The one `.lp` file of a folder.

    Raises
    ------
    InputError
        The folder is missing, or has none or several.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give the folder of the photographs")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".lp")
    if not found:
        raise InputError(f"{folder}: has no .lp file; add one with the number of lights and 'file x y z' for each")
    if len(found) > 1:
        raise InputError(f"{folder}: has {found[0].name} and {found[1].name}; keep one .lp file")
    return found[0]


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
    found = photographs.find(folder, lights)
    first = found[lights[0].name]
    sizes = {path: photographs.size(path) for path in found.values()}
    for path, size in sizes.items():
        if size != sizes[first]:
            raise InputError(
                f"{path}: is {size[0]}x{size[1]} but {first.name} is {sizes[first][0]}x{sizes[first][1]};"
                " all photographs of a set have one size"
            )
    for k, path in enumerate(found.values()):
        photographs.read(path, coder, crop)
        if sys.stderr.isatty():
            print(f"\rchecking photograph {k + 1} of {len(found)}", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print(file=sys.stderr)
    return lights


def held_out_count(lights: int, every: int) -> int:
    """How many of a list of lights are held out."""
    return sum(index % every == every // 2 for index in range(lights)) if every else 0


def plan(fabric: str, lights: list[Light], encoded: str, crop: str) -> Plan:
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
    for k, name in enumerate(group_names(len(lights))):
        inside = entries[k * GROUP : (k + 1) * GROUP]
        shots = tuple(Shot(light.name, "light", light.index, light.theta, light.phi) for light in inside)
        groups.append(Group(name, tuple(light.index for light in inside), shots))
    return Plan(check_name(fabric, "fabric"), "list", (1.0,), entries, tuple(groups), encoding=encoded, crop=crop)


def manifest(plan_file: Path, name: str, folder: Path) -> dict[str, Any]:
    """Manifest of a group: the photographs where they lie, with their digests."""
    planned = read_plan(plan_file)
    group = planned.group(name)
    found = photographs.find(folder, list(read_lp(lp_file(folder))))
    shots = []
    for shot in group.shots:
        path = found[shot.shot].resolve()
        frame = {"file": str(path), "sha256": sha256(path), "bytes": path.stat().st_size, "exposure_s": None}
        shots.append(
            {
                "shot": shot.shot,
                "kind": shot.kind,
                "light": shot.light,
                "revision": 0,
                "pose_mdeg": None,
                "photodiode": None,
                "time_s": None,
                "frames": [frame],
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
