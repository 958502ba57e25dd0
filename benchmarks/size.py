"""`kinran rti` on a set of photographs or RAW brackets of any size: processor time and peak memory of every stage.

The set is woven by formula, with lobes that no model of Kinran has, and noise that is new under each light. Each stage
notes its time and memory as it ends (`benchmarks.fabrics`); `prepare` is what happens before the first of them.
"""

import argparse
import math
import os
import tempfile
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pillow

from benchmarks.fabrics import measured, print_table
from kinran.base.apart import spread
from kinran.base.encoding import to_srgb
from kinran.base.files import write_json
from kinran.base.frames import direction
from kinran.run import rti
from kinran.run.resources import Size
from kinran.virtual.dng import Tags, write_dng

Array = NDArray[np.float64]

REPEAT = 480
"""Texels along a side of what the set repeats: no fit is faster for it."""
SENSOR, BORDER = (2592, 3888), 18
"""Height and width of the RAW frames, as the camera of Takeda2008 has them, and rows under its mask."""
BLACK, FULL, READ, ELECTRONS = 256, 3726, 1.7, 12.0
"""Counts of black and of a full site, read noise in counts, and electrons a count: those of a 12-bit camera."""
TIMES = (Fraction(1, 25), Fraction(1, 100), Fraction(1, 250), Fraction(1, 1000), Fraction(1, 4000))
"""Shutter times in seconds of the brackets."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--lights", type=int, default=12, help="number of lights (12)")
    parser.add_argument("--megapixels", type=float, default=2.0, help="size of a photograph (2)")
    parser.add_argument("--raw", action="store_true", help="brackets of five RAW frames of 10 megapixels instead")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1, help="cores of the run (all)")
    parser.add_argument("--folder", type=Path, help="where to keep set and results; a temporary folder if not given")
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Make a set, run it, print a table, write JSON."""
    with tempfile.TemporaryDirectory(prefix="kinran-size-") as scratch:
        folder = args.folder or Path(scratch)
        height = round(math.sqrt(args.megapixels * 1e6 * 2 / 3))
        shape = SENSOR if args.raw else (height, round(args.megapixels * 1e6 / height))
        if not (folder / "set" / "lights.lp").is_file():
            write_set(folder / "set", args.lights, shape, args.raw)
        start, began = time.process_time(), time.monotonic()
        work = rti.prepare(rti.Inputs(folder / "set"), folder / "out", rti.Options())
        prepare = {"jobs": 1, "cpu_s": time.process_time() - start, "peak_mb": 0.0, "imports_s": 0.0, "model_s": 0.0}
        texels = shape[0] * shape[1] // (4 if args.raw else 1)
        results: dict[str, Any] = measured(work, args.cores, 1, Size(texels, args.lights))
    results["stages"]["prepare"] = prepare
    results["cpu_s"] += prepare["cpu_s"]
    results["wall_s"] += time.monotonic() - began - results["wall_s"]
    print_table(results)
    if args.out:
        write_json(args.out, {"lights": args.lights, "texels": texels, "raw": args.raw, **results})


def write_set(folder: Path, lights: int, shape: tuple[int, int], raw: bool) -> None:
    """Write photographs, or brackets of RAW frames, of a woven cloth under lights that are spread over the dome."""
    folder.mkdir(parents=True)
    random = np.random.default_rng(7)
    grid = np.arange(4000) + 0.5
    dome = direction(np.arccos(1 - (1 - math.cos(math.radians(75))) * grid / len(grid)), grid * math.pi * (3 - 5**0.5))
    vectors = dome[spread(dome, lights)]
    noise = random.standard_normal((shape[0] + 64, shape[1] + 64), np.float32)
    for k, light in enumerate(vectors):
        cloth = woven(light)
        at = random.integers(0, 64, 2)
        own = noise[at[0] : at[0] + shape[0], at[1] : at[1] + shape[1]]
        if raw:
            write_bracket(folder, f"light_{k:03d}", cloth, own)
        else:
            whole = np.tile(cloth, (-(-shape[0] // REPEAT), -(-shape[1] // REPEAT), 1))[: shape[0], : shape[1]]
            seen = to_srgb(np.clip(whole, 0, 1)) * 255 + 1.5 * own[..., None]
            picture = Pillow.fromarray(np.clip(seen + 0.5, 0, 255).astype(np.uint8))
            picture.save(folder / f"light_{k:03d}.jpg", quality=95, subsampling=0)
    name = "light_{:03d}" + (".dng" if raw else ".jpg")
    rows = [" ".join((name.format(k), *(f"{x:.6f}" for x in v))) for k, v in enumerate(vectors.tolist())]
    (folder / "lights.lp").write_text("\n".join([str(lights), *rows]) + "\n", encoding="utf-8")


def woven(light: Array) -> NDArray[np.float32]:
    """Return the radiance (y, x, 3) of a repeat of the cloth under a light: gold and red threads, over and under."""
    y, x = (axis / REPEAT for axis in np.mgrid[:REPEAT, :REPEAT])
    gold = np.sin(2 * np.pi * 3 * x) * np.sin(2 * np.pi * 2 * y) > 0.2
    turn = 2 * np.pi * 60
    normal = np.stack([0.35 * np.sin(turn * x) * gold, 0.35 * np.sin(turn * y) * ~gold, np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    half = light + np.array([0.0, 0.0, 1.0])
    facing, shine = (np.maximum(normal @ v, 0) for v in (light, half / np.linalg.norm(half)))
    worn = 0.9 + 0.1 * np.sin(40 * (x + 3 * y))
    own = np.where(gold[..., None], (0.30, 0.22, 0.10), (0.32, 0.06, 0.07)) * worn[..., None]
    bright = np.where(gold, 0.6, 0.05) * shine ** np.where(gold, 60, 12)
    seen = own * facing[..., None] + bright[..., None] * np.where(gold[..., None], (1.0, 0.8, 0.4), (1.0, 1.0, 1.0))
    return (seen * light[2]).astype(np.float32)


def write_bracket(folder: Path, name: str, cloth: NDArray[np.float32], noise: NDArray[np.float32]) -> None:
    """Write the RAW frames of a light, as lossless JPEG in DNG; white fills a site in a hundredth of a second."""
    height, width = noise.shape
    sites = np.empty((height, width), np.float32)
    whole = np.tile(cloth, (-(-height // REPEAT // 2), -(-width // REPEAT // 2), 1))[: height // 2, : width // 2]
    for k, channel in enumerate((0, 1, 1, 2)):
        sites[k // 2 :: 2, k % 2 :: 2] = whole[..., channel]
    for k, seconds in enumerate(TIMES):
        counts = np.maximum(sites, 0) * float(seconds * 100) * (FULL - BLACK)
        own = np.roll(noise, 977 * k, axis=1)
        bayer = np.full((height + BORDER, width), BLACK, np.float32)
        bayer[BORDER:] += counts + np.sqrt(counts / ELECTRONS + READ**2) * own
        bayer[:BORDER] += READ * own[:BORDER]
        levels = np.clip(bayer + 0.5, 0, FULL).astype(np.uint16)
        said = Tags(seconds, BORDER, BLACK, 4095, "2026:01:01 00:00:00")
        encoded = bytes(imagecodecs.ljpeg_encode(levels, bitspersample=12))
        write_dng(folder / f"{name}_{k}.dng", levels, said, encoded)
