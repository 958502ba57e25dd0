"""Merge the shots of a group to radiance: whole shards of the stack.

RAW brackets are merged per sensor site before any demosaic, scaled so that a white diffuser that faces the lamp at
θ = 0 reads 1 (π·T), and corrected for the lamp's drift. Photographs are decoded to linear light.
"""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.distances import relative_light
from kinran.base.files import InputError, sha256, write_json
from kinran.base.log import progress
from kinran.base.shared_results import made
from kinran.bracket.shots import Taken, read_bracket, read_light, read_manifest, read_shot
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate.lamp import lamp_gains, level
from kinran.calibrate.radiometry import to_radiance
from kinran.data.block_average import average
from kinran.data.calibration import Calibration, read_calibration
from kinran.data.capture_plan import Plan, PlanLight, read_plan
from kinran.data.flat_field import divide
from kinran.data.mask import read_mask
from kinran.data.photographs import parse_crop, size
from kinran.data.radiance import OUTSIDE, SATURATED, Radiance
from kinran.data.radiance_stack import ShardWriter
from kinran.data.shards import NAMES, SHARD, group_shards, shard_path

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    plan: Annotated[Path, "plan of the capture (.json)"]
    calibration: Annotated[Path, "calibration of the capture (.json)"]
    manifest: Annotated[Path, "manifest of the group (.json)"]


@dataclass(frozen=True)
class Outputs:
    stack: Annotated[Path, "OUT", "radiance stack, of which the group's shards are written (.zarr)"]
    receipt: Annotated[Path | None, "what was merged, for the rule and the report (.json)"] = None


def main(inputs: Inputs, out: Outputs) -> None:
    """Write the group's shards, then the receipt."""
    plan, calibration = read_plan(inputs.plan), read_calibration(inputs.calibration)
    if calibration.plan_sha256 != plan.sha256:
        raise InputError(f"{inputs.calibration}: belongs to another plan; calibrate again")
    shots, group = read_manifest(inputs.manifest, plan), inputs.manifest.stem
    by_light = {shot.light: shot for shot in shots if shot.kind == "light"}
    lights = plan.group(group).lights
    monitors = [shot.light for part in plan.groups for shot in part.shots if shot.kind == "monitor"]
    shards = group_shards(lights, max((light for light in monitors if light is not None), default=None))
    wanted = [index for index in lights if index // SHARD in shards]
    if missing := [plan.lights[index].name for index in wanted if index not in by_light]:
        raise InputError(f"{inputs.manifest}: has no shot of light '{missing[0]}'; capture the group again")
    used = [plan.lights[index] for index in wanted]
    gains = None if plan.on_rig else distance_gains(shots, plan)
    evened, seen = relative_intensities(plan), without_colours(calibration)
    inside = mask_of(plan)

    def merge() -> dict[str, Any]:
        merged = merge_lights(inputs.manifest, shots, used, seen, gains, evened, inside, plan.average, out.stack)
        log.info("group %s: %d lights merged", group, len(used))
        return merged

    if all(frame.sha256 for shot in shots for frame in shot.frames):
        paths = (shard_path(out.stack, name, shard) for shard in shards for name in NAMES)
        files = {path.relative_to(out.stack).as_posix(): path for path in paths}
        merged = made(
            f"group {group}",
            "kinran.radiance.merge_group",
            lambda: (contents(shots), used, seen, gains, evened, plan.mask_sha256, plan.average),
            files,
            merge,
        )
    else:
        merged = merge()
    if out.receipt:
        receipt = {
            "fabric": plan.fabric,
            "group": group,
            "shards": shards,
            "sha256": merged["sha256"],
            "lights": len(used),
            "saturated": merged["saturated"],
            "lamp": merged["lamp"],
        }
        write_json(out.receipt, receipt)


def without_colours(calibration: Calibration) -> Calibration:
    """Return what a merge needs of a calibration: neither names nor colours, so that another chart changes no merge."""
    names: dict[str, Any] = {"fabric": "", "plan_sha256": "", "colour": "", "lamp": "", "generation": ""}
    colours: dict[str, Any] = {"to_acescg": (), "delta_e": (), "patches": (), "root_polynomial": None, "chart": ()}
    return replace(calibration, **names, **colours)


def contents(shots: list[Taken]) -> list[Any]:
    """Return what a merge follows from of shots: not the names of their files, but what is in them."""
    return [
        (
            *(shot.shot, shot.kind, shot.light, shot.time_s, shot.photodiode),
            [(frame.path.suffix, frame.nominal_s, frame.sha256) for frame in shot.frames],
        )
        for shot in shots
    ]


def merge_lights(
    manifest: Path,
    shots: list[Taken],
    lights: list[PlanLight],
    calibration: Calibration,
    gains: dict[str, float] | None,
    evened: dict[int, NDArray[np.float32]],
    inside: NDArray[np.bool_] | None,
    pixels: int,
    stack: Path,
) -> dict[str, Any]:
    """Write the shards of lights, which are whole shards in their order.

    Parameters
    ----------
    manifest
        Manifest of the group, to name in messages.
    shots
        Shots of the group.
    lights
        Lights that have shots among them.
    calibration
        Calibration of the capture.
    gains
        Relative light of the lamp at each shot, by name; None to measure it (`measure_gains`).
    evened
        Light (3,) of the lamps beside their mean, by index of the light (`relative_intensities`).
    inside
        Mask (y, x) of the texels that have samples; None for all.
    pixels
        Pixels along a side of which one texel is the mean.
    stack
        Folder of the stack.

    Returns
    -------
    dict
        SHA-256 of the shards, share of saturated samples, and relative light of the lamp, for the receipt.
    """
    by_light = {shot.light: shot for shot in shots if shot.kind == "light"}
    gains = measure_gains(shots, calibration, manifest) if gains is None else gains
    saturated, samples = 0, 0
    digests: dict[str, str] = {}
    shards = sorted({light.index // SHARD for light in lights})
    for shard in progress(shards, f"group {manifest.stem}", "shards"):
        with ShardWriter(stack, calibration.height // pixels, calibration.width // pixels) as writer:
            for light in (light for light in lights if light.index // SHARD == shard):
                picture = merge_shot(by_light[light.index], calibration, gains, light.theta, light.phi)
                if calibration.lamps:  # measured on a card: intensities that are stated as well are part of it
                    picture = divide(picture, calibration.lamps[light.index].values(*picture.flags.shape[:2]))
                elif light.index in evened:
                    picture = picture.with_value(picture.value / evened[light.index])
                if inside is not None:
                    picture = picture.only(inside)
                picture = average(picture[None], pixels)[0]
                writer.add(picture)
                saturated += int(np.count_nonzero(picture.has(SATURATED)))
                samples += int(np.count_nonzero(~picture.has(OUTSIDE)))
                del picture  # before the next light's frames are read
            written = writer.write(shard * SHARD)
        digests |= {path.relative_to(stack).as_posix(): sha256(path) for path in written}
    return {"sha256": digests, "saturated": saturated / max(samples, 1), "lamp": gains}


def mask_of(plan: Plan) -> NDArray[np.bool_] | None:
    """Return the mask (y, x) of a plan's texels; None without one.

    Raises
    ------
    InputError
        It has changed since the plan was made.
    """
    if not plan.mask:
        return None
    path = Path(plan.mask)
    if not path.is_file() or sha256(path) != plan.mask_sha256:
        raise InputError(f"{path}: the mask is not the one that was ingested; ingest the folder again")
    return read_mask(path, size(path), parse_crop(plan.crop))


def distance_gains(shots: list[Taken], plan: Plan) -> dict[str, float]:
    """Return the relative light of equal lamps at each shot, by name, from their distances; 1 if these are unknown."""
    positions = [light.position_mm for light in plan.lights if light.position_mm]
    known = len(positions) == len(plan.lights)
    gains = relative_light(positions) if known else np.ones(len(plan.lights))
    return {shot.shot: float(gains[shot.light or 0]) for shot in shots}


def relative_intensities(plan: Plan) -> dict[int, NDArray[np.float32]]:
    """Return the light (3,) of each lamp in R, G, B relative to their mean, by index; empty where all are alike."""
    stated = [light.intensity for light in plan.lights]
    known = [value for value in stated if value is not None]
    if len(known) < len(stated):
        return {}
    values = np.array(known, np.float64)
    return dict(enumerate((values / values.mean(0)).astype(np.float32)))


def measure_gains(shots: list[Taken], calibration: Calibration, manifest: Path) -> dict[str, float]:
    """Return the light of the rig's lamp at each shot of a group, by name, relative to that on the white plate.

    Raises
    ------
    InputError
        The calibration is of photographs, or `lamp_gains` fails.
    """
    camera = calibration.camera
    if camera is None:
        raise InputError(f"{manifest}: is of a rig, but its calibration is of photographs; calibrate again")
    monitors = [shot for shot in shots if shot.kind == "monitor"]
    levels = {shot.shot: level(merge_bracket(read_bracket(shot), camera)) for shot in monitors}
    return lamp_gains(shots, camera, levels, manifest)


def merge_shot(shot: Taken, calibration: Calibration, gains: dict[str, float], theta: float, phi: float) -> Radiance:
    """Merge a shot of the light at (θ, φ), in degrees, to radiance (y, x, 3) in the stack's unit."""
    if calibration.camera is None:
        picture = read_light(shot, calibration)
        return picture.with_value(picture.value / np.float32(gains[shot.shot]))
    picture = merge_bracket(read_shot(shot, calibration), calibration.camera)
    return to_radiance(picture, calibration.camera, gains[shot.shot], theta, phi)
