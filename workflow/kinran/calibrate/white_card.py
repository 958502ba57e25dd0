"""Photographs of a white card under the lights of a set: what each lamp's light is over the picture."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.distances import relative_light
from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.base.log import progress
from kinran.bracket.shots import Frame, Taken, read_shot
from kinran.bracket.superpixels import merge_bracket
from kinran.calibrate.lamp import irradiance
from kinran.calibrate.white_plate import fit_flat
from kinran.data.calibration import Calibration
from kinran.data.capture_plan import Plan, PlanLight
from kinran.data.flat_field import Flat
from kinran.data.light import LpLight
from kinran.data.nominal_time import check_alike, exposure_of, nominal_seconds
from kinran.data.photographs import find_frames, parse_crop, read
from kinran.data.picture_kind import is_raw
from kinran.data.radiance import HOT, SATURATED, Image, Radiance

MOST_SATURATED = 0.05
"""Largest share of a card's samples at white: more would pull its surface down. A choice."""
DARKEST = 0.01
"""Least light of a card beside white: under it, 8 bits tell it to 10 % at best."""
UNEVEN = 0.1
"""Largest median deviation of a card from a smooth surface: paper and noise stay under it, patterned cloth does not."""


def find_card(folder: Path, names: Sequence[str]) -> dict[str, list[Path]]:
    """Find the photographs of a card for lights of these names: by name or, where no name is there, by order.

    Raises
    ------
    InputError
        The folder or a photograph is missing.
    """
    return find_frames(folder, [LpLight(name, (0.0, 0.0, 1.0), name) for name in names])


def measure_card(plan: Plan, calibration: Calibration, folder: Path) -> tuple[Flat, ...]:
    """Measure the light of each lamp of a set on a card, relative to the mean of the lamps in the middle.

    What is known is no part of it: the cosine at the card, and where lamps have positions, their distances.

    Parameters
    ----------
    plan
        Plan of the set.
    calibration
        Calibration of the set, which decodes the card as well.
    folder
        Folder of the card's photographs.

    Returns
    -------
    (light,) Flat
        In the order of the plan's lights; a picture divided by it is as under even lamps.

    Raises
    ------
    InputError
        A photograph is missing, saturated, dark, uneven, of another size, or exposed otherwise than the others.
    """
    found = find_card(folder, [light.name for light in plan.lights])
    settings = {path: exposure_of(path) for frames in found.values() for path in frames}
    check_alike(settings, len(settings) == len(found))
    positions = [light.position_mm for light in plan.lights if light.position_mm]
    near = relative_light(positions) if len(positions) == len(plan.lights) else np.ones(len(plan.lights))
    flats, levels = [], []
    for light in progress(plan.lights, "card", "photographs"):
        frames = found[light.name]
        picture = _read(light, frames, calibration)
        if picture.value.shape[:2] != (calibration.height, calibration.width):
            raise InputError(
                f"{frames[0]}: gives {picture.value.shape[1]} × {picture.value.shape[0]} texels but the set"
                f" {calibration.width} × {calibration.height}; photograph the card as the set"
            )
        flat, level = _of_lamp(frames[0], picture, light, plan, calibration.camera is None)
        flats.append(flat)
        levels.append(level / math.cos(math.radians(light.theta)) / near[light.index])
    relative = np.array(levels) / np.mean(levels, 0)
    return tuple(
        replace(flat, coefficients=tuple(map(tuple, (gains[:, None] * flat.coefficients).tolist())))
        for flat, gains in zip(flats, relative, strict=True)
    )


def _read(light: PlanLight, frames: list[Path], calibration: Calibration) -> Radiance:
    """Read the card under a lamp as linear light (y, x, 3) on the scale of the set."""
    if calibration.camera is None:
        return read(frames[0], parse(calibration.encoding), parse_crop(calibration.crop))
    alone = len(frames) == 1 and not is_raw(frames[0])
    taken = tuple(Frame(path, 1.0 if alone else nominal_seconds(path)) for path in frames)
    shot = Taken(light.name, "light", light.index, None, None, taken)
    return merge_bracket(read_shot(shot, calibration), calibration.camera)


def _of_lamp(
    path: Path, picture: Radiance, light: PlanLight, plan: Plan, codes: bool
) -> tuple[Flat, NDArray[np.float64]]:
    """Return the flat field of a lamp, 1 in the middle, and its light (3,) there."""
    clipped = float(picture.has(SATURATED).any(-1).mean())
    if clipped > MOST_SATURATED:
        raise InputError(f"{path}: {clipped:.0%} of the card is saturated; expose it shorter, all lights alike")
    if codes and np.median(picture.value) < DARKEST:
        raise InputError(
            f"{path}: the card reads {np.median(picture.value):.2%} of white; expose it longer, all lights alike"
        )
    height, width = picture.value.shape[:2]
    far: Image = np.ones((height, width, 1), np.float32)
    if light.position_mm and plan.field_mm:
        far = irradiance(light.position_mm, height, width, plan.field_mm)[..., None]
    flat = fit_flat(picture, far, light.theta, light.phi)
    even = picture.value / far / flat.values(height, width)
    sound = ~picture.has(SATURATED | HOT)
    level = np.array([np.median(even[..., k][sound[..., k]]) for k in range(3)], float)
    off = float(np.median(np.abs(even / level.astype(np.float32) - 1)))
    if not (level > 0).all() or off > UNEVEN:
        raise InputError(
            f"{path}: differs by {off:.0%} from a smooth surface; give photographs of an even white card that fills"
            " the picture"
        )
    return flat, level
