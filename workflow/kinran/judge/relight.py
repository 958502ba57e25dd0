"""Relight a material: one picture for each light, from the view of the measurement; the lights are far away."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from kinran.base.encoding import Encoding, parse
from kinran.base.exr import write_rgb
from kinran.base.files import InputError, read_json
from kinran.base.log import progress
from kinran.data import metrics, photographs
from kinran.data.block_average import average
from kinran.data.light import LpLight, directions
from kinran.data.light_files import read_lights
from kinran.data.radiance import Image, Radiance
from kinran_bsdf.material import Material, read_material
from kinran_bsdf.relight import relight

BATCH = 16
"""Lights that are relit at once, so that memory holds no more pictures; results do not depend on it."""


@dataclass(frozen=True)
class Inputs:
    material: Annotated[Path, "MATERIAL.exr", "material to relight"]
    lights: Annotated[Path, "--lights FILE.lp", "lights of an RTI set"]
    against: Annotated[Path | None, "--against FOLDER", "photographs under these lights, by name"] = None


def main(inputs: Inputs, out: Annotated[Path, "--out DIR", "folder for one EXR a light"]) -> None:
    """Write linear float EXRs (R, G, B; top row first) in the unit of the material's photographs."""
    try:
        material = read_material(inputs.material)
    except (ValueError, OSError) as error:
        raise InputError(str(error)) from None
    lights = read_lights(inputs.lights).lights
    found = photographs.find(inputs.against, lights) if inputs.against else {}
    batches = (lights[start : start + BATCH] for start in range(0, len(lights), BATCH))
    images = (image for batch in batches for image in relight(material, directions(batch)))
    held_out = _held_out(inputs.material) if inputs.against else set()
    pairs, scores = zip(lights, images, strict=True), []
    for light, image in pairs if inputs.against else progress(pairs, "relight", "lights", len(lights)):
        write_rgb(out / f"{light.name}.exr", image[::-1])
        if inputs.against:
            scores.append(_compare(material, light, image, found[light.name]))
            print(f"{light.name}  {scores[-1]:.2f} dB{'  held out' * (light.name in held_out)}", flush=True)
    if scores:
        apart = np.array([light.name in held_out for light in lights])
        for what, chosen in (("held out", apart), ("fitted", ~apart)) if apart.any() else (("mean", ~apart),):
            some = np.array(scores)[chosen]
            if some.size:
                print(f"{what}  {some.mean():.2f} dB  (worst {some.min():.2f} dB, {some.size} lights)")
    else:
        print(f"{len(lights)} pictures in {out}")


def _held_out(material: Path) -> set[str]:
    """Names of the lights that a material has not seen, from the evaluation beside it; none where there is none."""
    path = material.with_name("evaluation.json")
    return set(read_json(path)["held_out"]) if path.is_file() else set()


def _made_from(photograph: Radiance, shape: tuple[int, ...]) -> Image:
    """Return the light of a photograph, averaged where the material was made from averages of so many pixels."""
    pixels = photograph.value.shape[0] // shape[0]
    if pixels > 1 and photograph.value.shape[1] // pixels == shape[1]:
        return average(photograph[None], pixels)[0].value
    return photograph.value


def _compare(material: Material, light: LpLight, image: Image, path: Path) -> float:
    """PSNR of a relit picture, in the encoding of the photographs that the material was made from."""
    encoding: Encoding = parse(material.encoding or "linear")
    truth = _made_from(photographs.read(path, encoding, photographs.parse_crop(material.crop)), image.shape)
    if truth.shape != image.shape:
        truth = photographs.read(path, encoding).value
    if truth.shape != image.shape:
        raise InputError(
            f"{path}: is {truth.shape[1]}x{truth.shape[0]} but the material is {image.shape[1]}x{image.shape[0]};"
            " compare with the photographs that it was made from"
        )
    measured = np.broadcast_to(material.channels["label"][..., None] >= 0, image.shape).astype(np.float32)
    if material.encoding:
        return metrics.psnr(encoding.encode(image), encoding.encode(truth), measured)
    peak = float(np.percentile(truth, 99.9)) or 1.0
    return metrics.psnr(metrics.to_display(image, None, peak), metrics.to_display(truth, None, peak), measured)
