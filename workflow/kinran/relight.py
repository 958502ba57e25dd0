"""Relight a material: one picture a light, at the view at which it was measured; lights are directions, far away."""

import argparse
import sys
from pathlib import Path

import numpy as np

from kinran import metrics, photographs
from kinran.encoding import Encoding, parse
from kinran.exr import write_rgb
from kinran.files import InputError
from kinran.lights import Light, directions, read_lp
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.relight import relight

BATCH = 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("material", type=Path, metavar="MATERIAL.exr")
    parser.add_argument("--lights", type=Path, required=True, metavar="FILE.lp", help="lights, as of an RTI set")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder for one EXR a light")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="photographs under these lights, by name")


def main(args: argparse.Namespace) -> None:
    """Write linear float EXRs (R, G, B; top row first) in the unit of the material's photographs."""
    try:
        material = read_material(args.material)
    except (ValueError, OSError) as error:
        raise InputError(str(error)) from None
    lights = read_lp(args.lights)
    found = photographs.find(args.against, lights) if args.against else {}
    scores = []
    for start in range(0, len(lights), BATCH):
        batch = lights[start : start + BATCH]
        for light, image in zip(batch, relight(material, directions(batch)), strict=True):
            write_rgb(args.out / f"{light.name}.exr", image[::-1])
            if args.against:
                scores.append(_compare(material, light, image, found[light.name]))
                print(f"{light.name}  {scores[-1]:.2f} dB", flush=True)
            elif sys.stderr.isatty():
                print(f"\r{light.name}", end="", file=sys.stderr, flush=True)
    if scores:
        print(f"mean  {np.mean(scores):.2f} dB  (worst {np.min(scores):.2f} dB, {len(scores)} lights)")
    else:
        print(f"{len(lights)} pictures in {args.out}")


def _compare(material: Material, light: Light, image: photographs.Image, path: Path) -> float:
    """PSNR of a relit picture, in the encoding of the photographs that the material was made from."""
    encoding: Encoding = parse(material.encoding or "linear")
    truth = photographs.read(path, encoding, photographs.parse_crop(material.crop)).light
    if truth.shape != image.shape:
        truth = photographs.read(path, encoding).light
    if truth.shape != image.shape:
        raise InputError(
            f"{path}: is {truth.shape[1]}x{truth.shape[0]} but the material is {image.shape[1]}x{image.shape[0]};"
            " compare with the photographs that it was made from"
        )
    ones = np.ones_like(image)
    if material.encoding:
        return metrics.psnr(encoding.encode(image), encoding.encode(truth), ones)
    peak = float(np.percentile(truth, 99.9)) or 1.0
    return metrics.psnr(metrics.to_display(image, None, peak), metrics.to_display(truth, None, peak), ones)
