"""The real sets of the benchmark: photographs, lights, and which of them are held out."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.data import light_files, photographs, radiance_stack
from kinran.data.photographs import Crop
from kinran.data.radiance import SATURATED, Radiance

Array = NDArray[np.float64]
Images = NDArray[np.float32]
Mask = NDArray[np.bool_]

SIDE = 128
"""Texels along a side of the part of a set that is fitted. A choice: all thirteen sets then take minutes."""
EVERY, FIRST = 8, 4
"""Light number 4, 12, 20, … is held out where a set has no split of its own."""
ACESCG = np.eye(3)
"""No set says what its colours are: they are taken as they come."""


@dataclass(frozen=True)
class RealSet:
    """Photographs under known lights, row 0 at the bottom.

    Attributes
    ----------
    light : (n, y, x, 3) float32
        Linear light.
    saturated : (n, y, x, 3) bool
    directions : (n, 3)
    held : (n,) bool
        Whether a light is held out from the fits.
    encoding
        Encoding of the photographs.
    normals : (y, x, 3) or None
        True normals; 0 where there is no surface.
    """

    light: Images
    saturated: Mask
    directions: Array
    held: Mask
    encoding: str
    normals: Array | None = None

    def write(self, folder: Path) -> None:
        """Write the radiance stack of the set."""
        flags = np.where(self.saturated, SATURATED, 0).astype(np.uint8)
        radiance_stack.write_shards(folder, 0, Radiance(self.light, flags))
        of_stack = tuple(
            radiance_stack.Light(f"{k:04d}", (float(d[0]), float(d[1]), float(d[2])), held_out=bool(h))
            for k, (d, h) in enumerate(zip(self.directions, self.held, strict=True))
        )
        height, width = self.light.shape[1:3]
        known = radiance_stack.Metadata(of_stack, height, width, None, self.encoding, "", "photograph", ACESCG, {})
        radiance_stack.write_metadata(folder, known)


def every_eighth(count: int) -> Mask:
    """Whether each of `count` lights is held out; (count,) bool."""
    return np.asarray(np.arange(count) % EVERY == FIRST)


def dome(*folders: Path) -> RealSet:
    """Read the middle of 8-bit sRGB photographs with a `.lp`; of two folders the second is held out."""
    parts = [_photographs(folder) for folder in folders]
    light, saturated, directions = (np.concatenate([part[k] for part in parts]) for k in range(3))
    own = np.arange(len(light)) >= len(parts[0][0])
    return RealSet(light, saturated, directions, own if len(parts) > 1 else every_eighth(len(light)), "srgb")


def _photographs(folder: Path) -> tuple[Images, Mask, Array]:
    listed = light_files.find_lights(folder).lights
    found = photographs.find(folder, listed)
    width, height = photographs.size(found[listed[0].name])
    crop = Crop((width - SIDE) // 2, (height - SIDE) // 2, SIDE, SIDE)
    read = [photographs.read(found[light.name], encoding.parse("srgb"), crop) for light in listed]
    directions = np.array([light.direction for light in listed])
    return np.stack([r.value for r in read]), np.stack([r.has(SATURATED) for r in read]), directions


def ball(folder: Path) -> RealSet:
    """Read the ball of DiLiGenT [Shi2019]: 16 bits, linear, over the strength of each lamp; the background is black."""
    names = (folder / "filenames.txt").read_text(encoding="utf-8").split()
    strength = np.loadtxt(folder / "light_intensities.txt")
    read = [photographs.read(folder / name, encoding.parse("linear"), None) for name in names]
    mask = photographs.read(folder / "mask.png", encoding.parse("linear"), None).value[..., 0] > 0.5
    light: Images = np.stack([r.value for r in read]) / np.float32(strength[:, None, None])
    light = np.asarray(light * mask[..., None] / np.percentile(light[:, mask], 99.9), np.float32)
    normals = np.load(folder / "normal_gt.npy")[::-1] * mask[..., None]
    directions = np.loadtxt(folder / "light_directions.txt")
    saturated = np.stack([r.has(SATURATED) for r in read])
    return RealSet(light, saturated, directions, every_eighth(len(light)), "linear", normals)


def dense(folder: Path) -> RealSet:
    """Read the first frame of each direction of a video with a lamp in hand."""
    listed = np.loadtxt(folder / "lightvec.txt")
    first = np.sort(np.unique(np.round(listed, 6), axis=0, return_index=True)[1])
    read = [photographs.read(folder / f"image{k + 1:04d}.png", encoding.parse("gamma:2.2"), None) for k in first]
    light, saturated = np.stack([r.value for r in read]), np.stack([r.has(SATURATED) for r in read])
    directions = listed[first] / np.linalg.norm(listed[first], axis=1, keepdims=True)
    return RealSet(light, saturated, directions, every_eighth(len(first)), "gamma:2.2")


def sets() -> dict[str, Callable[[Path], RealSet]]:
    """Sets by name, each to be read from the folder of the data."""
    found: dict[str, Callable[[Path], RealSet]] = {
        name: lambda data, name=name: dome(data / "realrti" / name)  # type: ignore[misc]
        for name in ("item3", "item5", "item11")
    }
    for k in range(1, 9):
        found[f"material{k}"] = lambda data, k=k: dome(  # type: ignore[misc]
            *(data / "synthrti" / "Single" / "Object1" / f"material{k}" / part for part in ("Dome", "Test"))
        )
    found["ball"] = lambda data: ball(data / "diligent_ball")
    found["densePS"] = lambda data: dense(data / "densePS_data02")
    return found
