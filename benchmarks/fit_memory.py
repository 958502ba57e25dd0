"""Peak memory of the stage `fit` on a synthetic stack of ten megapixels under a few lights."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.texels import grid, microfacets, noisy, texels
from kinran.data.labels import write_labels
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import CHUNK, Light, Metadata, ShardWriter, write_metadata

HEIGHT, WIDTH = 2592, 3888
"""Texels of the paper's camera: 10.08 megapixels."""
JOB = "0/100"
"""Run of tiles that is fitted: INDEX/COUNT."""
RUN = """
import re, sys
from pathlib import Path
from kinran.__main__ import main
main(sys.argv[1:])
print(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1])
"""
"""Code that runs a command and prints its peak; that of `resource` counts the parent's memory, too."""


def measure(scratch: Path | None = None) -> dict[str, float]:
    """Fit a hundredth of ten megapixels in a process of its own; its peak, and the share of one tile in it, in MB."""
    with tempfile.TemporaryDirectory(dir=scratch) as name:
        folder = Path(name)
        lights = grid(40, 4)[:8]
        _write_stack(folder / "radiance.zarr", lights)
        one = np.zeros((HEIGHT, WIDTH), np.intp)
        full = np.ones((HEIGHT, WIDTH), np.float32)
        write_labels(folder / "labels.exr", one, full, one, full)
        command = ["fit", "--fabric", folder, "--tile", JOB]
        command += ["--model", "slope", "--lobes", "2", "--tail", "gaussian", folder / "fit.npz"]
        run = [sys.executable, "-c", RUN, *map(str, command)]
        done = subprocess.run(run, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        peak = int(done.stdout.split()[-1]) / 1024
        with np.load(folder / "fit.npz") as found:
            texels_done = sum(int((y1 - y0) * (x1 - x0)) for y0, y1, x0, x1 in found["boxes"])
    # float16 and flags as stored, float32 and weights as the solver takes them
    tile = CHUNK * CHUNK * len(lights) * (3 * 2 + 3 + 3 * 4 + 4) / 1e6
    return {
        "megapixels": HEIGHT * WIDTH / 1e6,
        "lights": len(lights),
        "texels_of_the_job": texels_done,
        "peak_mb": round(peak, 1),
        "tile_mb": round(tile, 1),
        "over_the_tile_mb": round(peak - tile, 1),
    }


def _write_stack(folder: Path, lights: NDArray[np.float64]) -> None:
    """Write a stack of a patch of facets, repeated."""
    patch = noisy(microfacets(*texels(36 * 36), lights)).transpose(2, 0, 1).reshape(len(lights), 36, 36, 3)
    with ShardWriter(folder, HEIGHT, WIDTH) as writer:
        for picture in patch:
            writer.add(Radiance.unflagged(np.tile(picture, (HEIGHT // 36, WIDTH // 36, 1))))
        writer.write(0)
    named = tuple(Light(f"light{k}", tuple(direction.tolist())) for k, direction in enumerate(lights))
    known = Metadata(named, HEIGHT, WIDTH, None, "", "", "Rec. 709", np.eye(3), {"kind": "none"})
    write_metadata(folder, known)
