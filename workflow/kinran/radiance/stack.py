"""Complete the radiance stack: the light at θ = 0, which lights are held out, and the metadata.

The repeats of θ = 0 are spread over all groups, so that no group alone can merge them.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from kinran.base.files import InputError
from kinran.bracket.shots import Taken, read_bracket, read_manifest
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate.lamp import lamp_gains, level
from kinran.calibrate.radiometry import to_radiance
from kinran.data.calibration import Calibration, read_calibration
from kinran.data.capture_plan import Plan, read_plan
from kinran.data.hold_out_rule import held_out
from kinran.data.radiance import DARK, SATURATED, Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.data.shards import NAMES, SHARD, check_receipt, shard_path

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    plan: Annotated[Path, "plan of the capture (.json)"]
    calibration: Annotated[Path, "calibration of the capture (.json)"]
    manifests: Annotated[tuple[Path, ...], "manifests of all groups (.json)"]
    receipts: Annotated[tuple[Path, ...], "receipts of the merged groups (.json)"] = ()


@dataclass(frozen=True)
class Options:
    holdout: Annotated[int, "hold out every so many lights; 0: none"] = 8


def main(inputs: Inputs, out: Annotated[Path, "OUT", "radiance stack (.zarr)"], options: Options = Options()) -> None:
    """Write the last shard and the metadata."""
    plan, calibration = read_plan(inputs.plan), read_calibration(inputs.calibration)
    if calibration.plan_sha256 != plan.sha256:
        raise InputError(f"{inputs.calibration}: belongs to another plan; calibrate again")
    for receipt in inputs.receipts:
        if not receipt.is_file():
            raise InputError(f"{receipt}: is missing; merge the group first")
        check_receipt(receipt, out)
    held = held_out([light.grid for light in plan.lights], options.holdout, inputs.plan)
    if plan.on_rig:
        groups = [(path, read_manifest(path, plan)) for path in inputs.manifests]
        write_shards(out, *last_shard(plan, calibration, groups))
    for shard in range(-(-len(plan.lights) // SHARD)):
        for path in (shard_path(out, name, shard) for name in NAMES):
            if not path.is_file():
                raise InputError(f"{path}: is missing; merge its group first")
    write_metadata(out, metadata_of(plan, calibration, held))
    log.info("%d lights, %d of them held out", len(plan.lights), len(held))


def metadata_of(plan: Plan, calibration: Calibration, held: set[int]) -> Metadata:
    """Return the metadata of a plan's stack; `held` are the indices of the held-out lights."""
    return Metadata(
        lights=tuple(
            Light(light.name, light.direction, light.position_mm, light.grid, index in held)
            for index, light in enumerate(plan.lights)
        ),
        height=calibration.height // plan.average,
        width=calibration.width // plan.average,
        texel_mm=plan.average * plan.field_mm / calibration.width if plan.field_mm else None,
        encoding=calibration.encoding if calibration.camera is None else "",  # merged brackets are radiance
        crop=calibration.crop,
        colour=calibration.colour,
        to_acescg=calibration.matrix,
        noise=calibration.noise(),
        masked=bool(plan.mask),
        camera_mm=(*(plan.axis_mm or (0.0, 0.0)), plan.camera_mm) if plan.camera_mm else None,
    )


def last_shard(
    plan: Plan, calibration: Calibration, groups: Sequence[tuple[Path, list[Taken]]]
) -> tuple[int, Radiance]:
    """Merge the shard with the light at θ = 0: the mean of its repeats in all groups, and the lights that share it.

    Returns
    -------
    first : int
        Index of the shard's first light.
    radiance : (light, y, x, 3)
        Radiance of the shard's lights.

    Raises
    ------
    InputError
        A light has no shot in the manifests.
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
        gains = lamp_gains(shots, camera, {shot.shot: level(merged[shot.shot]) for shot in monitors}, path)
        for shot in wanted:
            picture = merged.pop(shot.shot)
            light = plan.lights[shot.light or 0]
            repeats = found.setdefault(light.index, Repeats(picture.value.shape))
            repeats.add(to_radiance(picture, camera, gains[shot.shot], light.theta, light.phi))
    for light in plan.lights[first:]:
        if light.index not in found:
            raise InputError(f"light '{light.name}' has no shot in the manifests; capture its group")
    means = [found[index].mean() for index in sorted(found)]
    return first, Radiance(np.stack([mean.value for mean in means]), np.stack([mean.flags for mean in means]))


class Repeats:
    """Mean of pictures (y, x, 3) of one light, which leaves saturated samples out where there are others."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self._open, self._all = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        self._count, self._pictures = np.zeros(shape, np.uint16), 0
        self._any, self._every = np.zeros(shape, np.uint8), np.full(shape, 255, np.uint8)

    def add(self, picture: Radiance) -> None:
        """Add a picture."""
        full = picture.has(SATURATED)
        self._open += np.where(full, 0, picture.value)
        self._all += picture.value
        self._count += ~full
        self._pictures += 1
        self._any |= picture.flags
        self._every &= picture.flags

    def mean(self) -> Radiance:
        """Return the mean picture; saturated and dark where every picture is, hot and shifted where any is."""
        seen = self._count > 0
        mean = np.where(seen, self._open / np.maximum(self._count, 1), self._all / self._pictures)
        every = np.uint8(SATURATED | DARK)
        return Radiance(mean.astype(np.float32), (self._any & ~every) | (self._every & every))
