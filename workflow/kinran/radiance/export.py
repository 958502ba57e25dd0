"""Export a radiance stack: one OpenEXR file a light, linear ACEScg, unclipped, with the metadata of its colours.

The files are half float with ZIP compression, which every program reads. Saturated samples are lower bounds.
"""

import json
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from kinran.base.files import InputError, atomic
from kinran.base.log import progress
from kinran.calibrate.colour_chart import apply
from kinran.data.calibration import read_calibration
from kinran.data.radiance_stack import LARGEST, Stack

log = logging.getLogger(__name__)

AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
"""Chromaticities (x, y) of ACEScg: R, G, B and white."""
UNSAFE = '/\\:*?"<>|\0'
"""Characters that some file system does not allow in names."""


@dataclass(frozen=True)
class Inputs:
    stack: Annotated[Path, "STACK.zarr", "radiance stack"]
    calibration: Annotated[
        Path | None,
        "--calibration FILE.json",
        "calibration whose root polynomial, where it has one, takes the place of the stack's matrix",
    ] = None


@dataclass(frozen=True)
class Options:
    lights: Annotated[str, "--lights NAME,NAME,…", "lights to export; all without it"] = ""


def main(inputs: Inputs, out: Annotated[Path, "--out DIR", "folder to write"], options: Options = Options()) -> None:
    """Write the files."""
    stack = Stack.open(inputs.stack)
    matrix = stack.to_acescg
    if inputs.calibration:
        root = read_calibration(inputs.calibration).root_polynomial
        matrix = np.array(root) if root else matrix
    names = [light.name for light in stack.lights]
    wanted = options.lights.split(",") if options.lights else names
    for name in progress(wanted, "export", "lights"):
        if name not in names:
            raise InputError(f"{inputs.stack}: has no light '{name}'; it has {names[0]} to {names[-1]}")
        safe = "".join("_" if letter in UNSAFE else letter for letter in name)
        write_light(out / f"{safe}.exr", stack, names.index(name), matrix)
    log.info("%d lights in %s", len(wanted), out)


def write_light(path: Path, stack: Stack, index: int, matrix: NDArray[np.float64]) -> None:
    """Write the picture of a light, upright, and check it by reading it back.

    Raises
    ------
    InputError
        The folder cannot be written to.
    OSError
        The file reads back changed.
    """
    radiance = stack.read_tile(0, stack.height, 0, stack.width, [index]).value[0]
    colours = apply(matrix, radiance[::-1].astype(float))
    half = np.ascontiguousarray(np.clip(colours, -LARGEST, LARGEST).astype(np.float16))
    header = light_header(stack, index)
    with atomic(path) as temporary:
        with OpenEXR.File(header, {"RGB": half}) as file:
            file.write(str(temporary))
        with OpenEXR.File(str(temporary)) as file:
            if not np.array_equal(file.channels()["RGB"].pixels, half):
                raise OSError(f"{path}: reads back changed; is the disk full?")


def light_header(stack: Stack, index: int) -> dict[str, object]:
    """Return the header attributes of a light's file."""
    light = stack.lights[index]
    header: dict[str, object] = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": AP1,
        "colorInteropID": "lin_ap1_scene",
        "adoptedNeutral": np.array(AP1[6:], np.float32),
        "kinran:light": light.name,
        "kinran:direction": np.array(light.direction, np.float32),
        "kinran:unit": stack.unit,
        "kinran:noise": json.dumps(stack.noise),
    }
    if light.position_mm:
        header["kinran:positionMM"] = np.array(light.position_mm, np.float32)
    seconds = stack.noise.get("seconds")
    if seconds:
        header["expTime"] = float(max(seconds))
    return header
