"""Export a radiance stack: one OpenEXR file a light, linear ACEScg, unclipped, with the metadata of its colours.

Half float, ZIP, which every program reads; the stack stays the store. Saturated samples are lower bounds.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import NDArray

from kinran.files import InputError, atomic
from kinran.radiance.calibration import read_calibration
from kinran.radiance.colour_chart import apply
from kinran.stack import LARGEST, Stack

Image = NDArray[np.float32]

AP1 = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
"""Chromaticities of ACEScg: R, G, B and white."""
UNSAFE = '/\\:*?"<>|\0'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("stack", type=Path, metavar="STACK.zarr")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.add_argument("--lights", default="", metavar="NAME,NAME,…", help="those to export; all without it")
    help_ = "calibration whose root polynomial, where it has one, takes the place of the stack's matrix"
    parser.add_argument("--calibration", type=Path, metavar="FILE.json", help=help_)


def main(args: argparse.Namespace) -> None:
    """Write the files."""
    stack = Stack.open(args.stack)
    matrix = stack.to_acescg
    if args.calibration:
        root = read_calibration(args.calibration).root_polynomial
        matrix = np.array(root) if root else matrix
    names = [light.name for light in stack.lights]
    wanted = args.lights.split(",") if args.lights else names
    for k, name in enumerate(wanted):
        if name not in names:
            raise InputError(f"{args.stack}: has no light '{name}'; it has {names[0]} to {names[-1]}")
        safe = "".join("_" if letter in UNSAFE else letter for letter in name)
        write_light(args.out / f"{safe}.exr", stack, names.index(name), matrix)
        if sys.stderr.isatty():
            print(f"\rlight {k + 1} of {len(wanted)}", end="", file=sys.stderr, flush=True)
    print(f"\r{len(wanted)} lights in {args.out}", file=sys.stderr)


def write_light(path: Path, stack: Stack, index: int, matrix: NDArray[np.float64]) -> None:
    """Write the picture of a light, upright; checked by reading it back.

    Raises
    ------
    InputError
        The folder cannot be written to.
    """
    radiance, _ = stack.read_tile(0, stack.height, 0, stack.width, [index])
    colours = apply(matrix, radiance[0, ::-1].astype(float))
    half = np.ascontiguousarray(np.clip(colours, -LARGEST, LARGEST).astype(np.float16))
    header = light_header(stack, index)
    with atomic(path) as temporary:
        with OpenEXR.File(header, {"RGB": half}) as file:
            file.write(str(temporary))
        with OpenEXR.File(str(temporary)) as file:
            if not np.array_equal(file.channels()["RGB"].pixels, half):
                raise OSError(f"{path}: reads back changed; is the disk full?")


def light_header(stack: Stack, index: int) -> dict[str, object]:
    """Attributes of a light's file."""
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
