"""Render a Mitsuba scene with Kinran materials to a linear EXR and a PNG to look at.

A user needs no Python: `kinran render scene.xml` registers the BSDF, which Mitsuba's own command cannot do.
"""

import logging
import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from kinran.base.checksums import comment_damaged
from kinran.base.encoding import to_srgb
from kinran.base.exr import write_rgb
from kinran.base.files import InputError, atomic, check_comment, write_json
from kinran.base.log import progress
from kinran.base.probes import variant_fault

log = logging.getLogger(__name__)

Picture = NDArray[np.float32]

MESH = re.compile(r'value="([^"]+\.ply)"')
"""A mesh that a scene file names."""
PASS = 16
"""Samples a pixel that are rendered at once, between two lines of progress: those over which a sampler spreads them."""
SHOULDER = 0.7
"""Linear value above which highlights roll off: nearly all of what is diffuse lies under it, and sRGB shows it at 0.85.
It was chosen by eye."""
SWEEP_SIZE, SWEEP_SPP, SWEEP_ANGLE = (240, 180), 16, 50.0
"""Pixels of a frame of the sweep, samples a pixel, and degrees from the normal at which the light starts and ends."""


@dataclass(frozen=True)
class Inputs:
    scene: Annotated[Path, "SCENE", "Mitsuba scene (XML)"]


@dataclass(frozen=True)
class Options:
    spp: Annotated[int | None, "samples a pixel; the scene's own number if not given"] = None
    variant: Annotated[str | None, "Mitsuba variant; llvm_ad_rgb where it works if not given"] = None
    sweep: Annotated[int | None, "--sweep N", "instead, a contact sheet (PNG) of 2 × N frames, the light moved"] = None


def main(
    inputs: Inputs,
    out: Annotated[Path | None, "EXR to write; beside the scene under its name if not given"] = None,
    options: Options = Options(),
) -> None:
    """Render a picture, or a contact sheet; `picture` and `sweep` name the errors."""
    scene, variant = inputs.scene, options.variant
    if options.sweep is not None:
        out = out or scene.with_name(f"{scene.stem}_sweep.png")
        sweep(scene, out.with_suffix(".png"), options.sweep, variant)
    else:
        picture(scene, out or scene.with_suffix(".exr"), options.spp, variant)


def choose_variant() -> str:
    """`llvm_ad_rgb`, or `scalar_rgb` with a warning where LLVM does not work."""
    reason = variant_fault("llvm_ad_rgb")
    if not reason:
        return "llvm_ad_rgb"
    log.warning(
        "warning: LLVM cannot be used (%s); rendering with scalar_rgb, about 100 times slower; "
        "install libllvm19 and run kinran doctor",
        reason,
    )
    return "scalar_rgb"


def use_variant(variant: str | None) -> Any:
    """Mitsuba with a variant set and the `kinran` BSDF registered.

    Raises
    ------
    InputError
        The variant does not exist.
    """
    import mitsuba as mi

    name = variant or choose_variant()
    if name not in mi.variants():
        raise InputError(f"variant '{name}': Mitsuba has only {', '.join(mi.variants())}")
    mi.set_variant(name)
    import kinran_bsdf  # noqa: F401  registers itself

    return mi


def load(path: Path, **parameters: Any) -> Any:
    """Load a scene with the current variant.

    Raises
    ------
    InputError
        The file is missing or Mitsuba refuses it.
    """
    import mitsuba as mi

    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        return mi.load_file(str(path), **parameters)
    except Exception as error:  # Mitsuba raises bare RuntimeError
        reason = " ".join(str(error).split())
        raise InputError(f"{path}: Mitsuba cannot load it ({reason})") from None


def check_files(scene: Path) -> None:
    """Check the meshes of a scene file against their checksums, and say where the scene itself has another.

    A scene is there to be edited, so that this is no error; materials are checked as they are read.

    Raises
    ------
    InputError
        A mesh does not match its checksum.
    """
    if not scene.is_file():
        return
    text = scene.read_bytes()
    if comment_damaged(text):
        log.warning("warning: %s: was edited, or damaged, since kinran scene wrote it", scene)
    for name in MESH.findall(text.decode("utf-8", "replace")):
        if (mesh := scene.parent / name).is_file():
            check_comment(mesh)


def render(scene: Any, spp: int, what: str = "") -> Picture:
    """Render in passes and average them.

    Parameters
    ----------
    scene
        A loaded Mitsuba scene.
    spp
        Samples a pixel.
    what
        Name of the scene, to log how many passes are done; empty to log nothing.

    Returns
    -------
    (y, x, 3) float32
        Linear Rec.709 radiance, top row first.
    """
    import mitsuba as mi

    width, height = scene.sensors()[0].film().crop_size()
    total = np.zeros((height, width, 3))
    passes = range(0, spp, PASS)
    for done in progress(passes, f"render {what}", "passes") if what else passes:
        samples = min(PASS, spp - done)
        total += samples * np.array(mi.render(scene, spp=samples, seed=done), np.float64)[..., :3]
    return (total / spp).astype(np.float32)


def _to_variables(scene: Any) -> None:
    """Make the numbers of a scene variables of its kernel, not literals in it: scenes that differ by numbers share it.

    To compile a kernel takes three times as long as a frame of a sweep.
    """
    import drjit as dr
    import mitsuba as mi

    if str(mi.variant()).startswith("scalar"):
        return
    values = mi.traverse(scene)
    for name, value in list(values.items()):
        if not name.endswith(".maps"):  # these are no literals, and large
            dr.make_opaque(value)
            values[name] = value
    values.update()


def develop(picture: Picture, exposure: float = 1.0) -> NDArray[np.uint8]:
    """Convert linear radiance to an 8-bit sRGB picture.

    Parameters
    ----------
    picture : (y, x, 3) float
    exposure
        Factor of the radiance; at 1 a radiance of 0.7 and less is shown as it is.

    Returns
    -------
    (y, x, 3) uint8
        Above the shoulder s = 0.7 a channel x becomes s + (1 - s)(1 - exp(-(x - s) / (1 - s))): it keeps its
        slope at s and nears 1 without reaching it, as film does, so that glints keep some of their shape and
        colour. Then the sRGB curve.
    """
    x = np.maximum(np.asarray(picture, np.float64) * exposure, 0)
    room = 1 - SHOULDER
    x = np.where(x > SHOULDER, SHOULDER + room * -np.expm1(-np.maximum(x - SHOULDER, 0) / room), x)
    return np.asarray(np.rint(to_srgb(x) * 255), np.uint8)


def _write_png(path: Path, image: Image.Image) -> None:
    with atomic(path) as temporary:
        image.save(temporary)


def picture(scene_file: Path, out: Path, spp: int | None = None, variant: str | None = None) -> None:
    """Render a scene file to `out` (linear EXR), and beside it a PNG and a JSON with time and samples.

    Raises
    ------
    InputError
        The scene cannot be loaded, a mesh is damaged, or the number of samples is no positive number.
    """
    if spp is not None and spp < 1:
        raise InputError(f"--spp {spp}: use at least one sample a pixel")
    check_files(scene_file)
    start = time.perf_counter()
    mi = use_variant(variant)
    scene = load(scene_file)
    loaded = time.perf_counter()
    samples = spp or int(scene.sensors()[0].sampler().sample_count())
    image = render(scene, samples, scene_file.name)
    rendered = time.perf_counter()
    if not np.isfinite(image).all():
        raise InputError(f"{scene_file}: renders to values that are not finite; check its material and lights")
    write_rgb(out, image)
    _write_png(out.with_suffix(".png"), Image.fromarray(develop(image)))
    write_json(
        out.with_suffix(".json"),
        {
            "scene": scene_file.name,
            "variant": mi.variant(),
            "width": image.shape[1],
            "height": image.shape[0],
            "spp": samples,
            "seconds_load": round(loaded - start, 3),
            "seconds_render": round(rendered - loaded, 3),
        },
    )


def sweep(scene_file: Path, out: Path, frames: int, variant: str | None = None) -> None:
    """Write a contact sheet: the key light moved along the weft (upper row) and along the warp (lower row).

    On cloth that hangs in folds along the warp, glints cross the folds to the right as the light moves to the
    right; the lobes of the material decide how they answer a light that moves up. A frame that is mirrored or
    turned shows as glints that run the other way.

    Parameters
    ----------
    scene_file
        Scene with defaults `key_weft` and `key_warp` in degrees, `width` and `height`.
    out
        PNG to write.
    frames
        Frames a row, from -50° to 50°.

    Raises
    ------
    InputError
        The scene cannot be loaded, a mesh is damaged, or the scene lacks one of the defaults.
    """
    if frames < 2:
        raise InputError(f"--sweep {frames}: a sweep has at least two frames")
    check_files(scene_file)
    use_variant(variant)
    from kinran_bsdf import shared_maps

    width, height = SWEEP_SIZE
    sheet = Image.new("RGB", (frames * width, 2 * height))
    draw = ImageDraw.Draw(sheet)
    angles = np.linspace(-SWEEP_ANGLE, SWEEP_ANGLE, frames)
    places = [(row, column) for row in range(2) for column in range(frames)]
    with shared_maps():
        for row, column in progress(places, f"sweep {scene_file.name}", "frames"):
            axis, angle = ("weft", "warp")[row], angles[column]
            light = {"key_weft": "0", "key_warp": "0", f"key_{axis}": f"{angle:.3f}"}
            scene = load(scene_file, **light, width=str(width), height=str(height))
            _to_variables(scene)
            corner = (column * width, row * height)
            sheet.paste(Image.fromarray(develop(render(scene, SWEEP_SPP))), corner)
            draw.text((corner[0] + 5, corner[1] + 4), f"{axis} {angle:+.0f}°", fill="white")
    _write_png(out, sheet)
