"""Merge the shots of a group to radiance: whole shards of the stack.

RAW brackets are merged per sensor site before any demosaic, scaled so that a white diffuser that faces the
lamp at θ = 0 reads 1 (π·T), and freed of the lamp's drift. Photographs are decoded to linear light.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.files import InputError, write_json
from kinran.geometry import relative_light
from kinran.plans import Plan, read_plan
from kinran.radiance.calibration import Calibration, read_calibration
from kinran.radiance.lamp import lamp_gains, level
from kinran.radiance.radiometry import to_radiance
from kinran.radiance.shots import Taken, read_bracket, read_light, read_manifest, read_shot
from kinran.radiance.superpixels import merge_bracket
from kinran.stack import SATURATED, SHARD, ShardWriter, group_shards

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--plan", type=Path, required=True, help="plan of the capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration (.json)")
    parser.add_argument("--manifest", type=Path, required=True, help="manifest of the group")
    parser.add_argument("--receipt", type=Path, help="what was merged, for the rule and the report (.json)")
    parser.add_argument("out", type=Path, help="radiance stack (.zarr)")


def main(args: argparse.Namespace) -> None:
    """Write the group's shards, then the receipt."""
    plan = read_plan(args.plan)
    calibration = read_calibration(args.calibration)
    if calibration.plan_sha256 != plan.sha256:
        raise InputError(f"{args.calibration}: belongs to another plan; calibrate again")
    shots = read_manifest(args.manifest, plan)
    by_light = {shot.light: shot for shot in shots if shot.kind == "light"}
    monitors = {shot.light for group in plan.groups for shot in group.shots if shot.kind == "monitor"}
    lights = plan.group(args.manifest.stem).lights
    shards = group_shards(lights, max((light for light in monitors if light is not None), default=None))
    wanted = [index for index in lights if index // SHARD in shards]
    if missing := [plan.lights[index].name for index in wanted if index not in by_light]:
        raise InputError(f"{args.manifest}: has no shot of light '{missing[0]}'; capture the group again")
    rig = plan.kind == "grid"
    gains = measure_gains(shots, calibration, args.manifest) if rig else distance_gains(shots, plan)
    saturated, samples = 0, 0
    for k, shard in enumerate(shards):
        inside = [index for index in wanted if index // SHARD == shard]
        poses = [(plan.lights[index].theta, plan.lights[index].phi) for index in inside]
        with ShardWriter(args.out, calibration.height, calibration.width) as writer:
            for index, pose in zip(inside, poses, strict=True):
                radiance, flags = merge_shot(by_light[index], calibration, gains, *pose)
                writer.add(radiance, flags)
                saturated += int(np.count_nonzero(flags & SATURATED))
                samples += flags.size
                del radiance, flags  # before the next light's frames are read
            writer.write(shard * SHARD)
        if sys.stderr.isatty():
            print(f"\rshard {k + 1} of {len(shards)}", end="", file=sys.stderr, flush=True)
    print(f"\rgroup {args.manifest.stem}: {len(wanted)} lights merged", file=sys.stderr)
    if args.receipt:
        receipt = {
            "fabric": plan.fabric,
            "group": args.manifest.stem,
            "shards": shards,
            "lights": len(wanted),
            "saturated": saturated / max(samples, 1),
            "lamp": gains,
        }
        write_json(args.receipt, receipt)


def distance_gains(shots: list[Taken], plan: Plan) -> dict[str, float]:
    """Light of equal lamps at each shot of photographs, by their distances; 1 where these are not known."""
    positions = [light.position_mm for light in plan.lights if light.position_mm]
    known = len(positions) == len(plan.lights)
    gains = relative_light(positions) if known else np.ones(len(plan.lights))
    return {shot.shot: float(gains[shot.light or 0]) for shot in shots}


def measure_gains(shots: list[Taken], calibration: Calibration, manifest: Path) -> dict[str, float]:
    """Light of the rig's lamp at each shot of a group."""
    camera = calibration.camera
    if camera is None:
        raise InputError(f"{manifest}: is of a rig, but its calibration is of photographs; calibrate again")
    monitors = [shot for shot in shots if shot.kind == "monitor"]
    levels = {shot.shot: level(*merge_bracket(read_bracket(shot), camera)) for shot in monitors}
    return lamp_gains(shots, camera, levels, manifest)


def merge_shot(
    shot: Taken, calibration: Calibration, gains: dict[str, float], theta: float, phi: float
) -> tuple[Image, Flags]:
    """Radiance (y, x, 3) of a shot of the light at (θ, φ) in the stack's unit, and its flags."""
    if calibration.camera is None:
        light, flags = read_light(shot, calibration)
        return light / np.float32(gains[shot.shot]), flags
    rate, flags = merge_bracket(read_shot(shot, calibration), calibration.camera)
    return to_radiance(rate, flags, calibration.camera, gains[shot.shot], theta, phi)
