"""Complete the radiance stack: the light at θ = 0, which lights are held out, and the metadata.

The repeats of θ = 0 are spread over all groups, so that no group alone can merge them.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.files import InputError
from kinran.plans import Plan, PlanLight, read_plan
from kinran.radiance.calibration import Calibration, read_calibration
from kinran.radiance.lamp import lamp_gains, level
from kinran.radiance.radiometry import to_radiance
from kinran.radiance.shots import Taken, read_bracket, read_manifest
from kinran.radiance.superpixels import merge_bracket
from kinran.stack import DARK, NAMES, SATURATED, SHARD, Light, shard_path, write_metadata, write_shards

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the stage."""
    parser.add_argument("--plan", type=Path, required=True, help="plan of the capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration (.json)")
    parser.add_argument("--manifests", type=Path, nargs="+", required=True, help="manifests of all groups")
    parser.add_argument("--receipts", type=Path, nargs="*", default=[], help="receipts of the merged groups")
    parser.add_argument("--holdout", type=int, default=8, help="hold out every so many lights; 0: none")
    parser.add_argument("out", type=Path, help="radiance stack (.zarr)")


def main(args: argparse.Namespace) -> None:
    """Write the last shard and the metadata."""
    plan, calibration = read_plan(args.plan), read_calibration(args.calibration)
    if calibration.plan_sha256 != plan.sha256:
        raise InputError(f"{args.calibration}: belongs to another plan; calibrate again")
    for receipt in args.receipts:
        if not receipt.is_file():
            raise InputError(f"{receipt}: is missing; merge the group first")
    held = held_out(plan, args.holdout)
    camera = calibration.camera
    if plan.kind == "grid":
        groups = [(path, read_manifest(path, plan)) for path in args.manifests]
        first, radiance, flags = last_shard(plan, calibration, groups)
        write_shards(args.out, first, radiance, flags)
    missing = [
        path
        for name in NAMES
        for shard in range(-(-len(plan.lights) // SHARD))
        if not (path := shard_path(args.out, name, shard)).is_file()
    ]
    if missing:
        raise InputError(f"{missing[0]}: is missing; merge its group first")
    lights = [
        Light(light.name, light.direction, light.position_mm, light.grid, index in held)
        for index, light in enumerate(plan.lights)
    ]
    write_metadata(
        args.out,
        lights,
        calibration.height,
        calibration.width,
        plan.field_mm / calibration.width if plan.field_mm else None,
        calibration.encoding if camera is None else "",  # merged brackets are radiance
        calibration.crop,
        calibration.colour,
        calibration.to_acescg,
        calibration.noise(),
        (*(plan.axis_mm or (0.0, 0.0)), plan.camera_mm) if plan.camera_mm else None,
    )
    print(f"{len(lights)} lights, {len(held)} of them held out", file=sys.stderr)


def held_out(plan: Plan, every: int) -> set[int]:
    """Indices of the lights to hold out.

    Of a grid those with (iθ + iφ) mod `every` = `every` // 2, but never θ = 0; of a list every `every`-th.

    Raises
    ------
    InputError
        `every` is negative or 1, or leaves no light to hold out or fewer than 4 to fit.
    """
    if every < 0 or every == 1:
        raise InputError(f"holdout {every}: give 0 for none, or 2 and more for every so many lights")
    held = {light.index for light in plan.lights if every and _is_held(light, every)}
    if every and not held:
        raise InputError(f"holdout {every}: holds out none of the {len(plan.lights)} lights; give a smaller number")
    if len(plan.lights) - len(held) < 4:
        raise InputError(f"holdout {every}: leaves {len(plan.lights) - len(held)} lights to fit; 4 are needed")
    return held


def _is_held(light: PlanLight, every: int) -> bool:
    if light.grid is None:
        return light.index % every == every // 2
    return light.grid[0] > 0 and sum(light.grid) % every == every // 2


def last_shard(
    plan: Plan, calibration: Calibration, groups: Sequence[tuple[Path, list[Taken]]]
) -> tuple[int, Image, Flags]:
    """The shard with the light at θ = 0: its repeats in all groups, and the lights that share the shard.

    Returns
    -------
    first : int
        Index of the shard's first light.
    radiance, flags : (light, y, x, 3)

    Raises
    ------
    InputError
        A light has no shot.
    """
    camera = calibration.camera
    first = (len(plan.lights) - 1) // SHARD * SHARD
    found: dict[int, Repeats] = {}
    if camera is None:
        raise ValueError("photographs have no repeats of θ = 0")
    for path, shots in groups:
        monitors = [shot for shot in shots if shot.kind == "monitor"]
        wanted = [shot for shot in shots if (shot.light or 0) >= first and shot.kind in ("light", "monitor")]
        if not wanted:
            continue
        merged = {shot.shot: merge_bracket(read_bracket(shot), camera) for shot in {*monitors, *wanted}}
        gains = lamp_gains(shots, camera, {shot.shot: level(*merged[shot.shot]) for shot in monitors}, path)
        for shot in wanted:
            rate, flags = merged.pop(shot.shot)
            light = plan.lights[shot.light or 0]
            repeats = found.setdefault(light.index, Repeats(rate.shape))
            repeats.add(*to_radiance(rate, flags, camera, gains[shot.shot], light.theta, light.phi))
    for light in plan.lights[first:]:
        if light.index not in found:
            raise InputError(f"light '{light.name}' has no shot in the manifests; capture its group")
    means = [found[index].mean() for index in sorted(found)]
    return first, np.stack([radiance for radiance, _ in means]), np.stack([flags for _, flags in means])


class Repeats:
    """Mean of pictures (y, x, 3) of one light, without their saturated samples where there are others."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._open, self._all = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._count, self._pictures = np.zeros(shape, np.uint16), 0
        self._any, self._every = np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)

    def add(self, radiance: Image, flags: Flags) -> None:
        """Take a picture."""
        full = (flags & SATURATED) > 0
        self._open += np.where(full, 0, radiance)
        self._all += radiance
        self._count += ~full
        self._pictures += 1
        self._any |= flags
        self._every &= flags

    def mean(self) -> tuple[Image, Flags]:
        """Mean of what was taken; saturated and dark where every picture is, hot and shifted where any is."""
        seen = self._count > 0
        mean = np.where(seen, self._open / np.maximum(self._count, 1), self._all / self._pictures)
        every = np.uint8(SATURATED | DARK)
        return mean.astype(np.float32), (self._any & ~every) | (self._every & every)
