"""Accuracy on path-traced objects that are no fabric, under two domes: sets that no choice was made on."""

import argparse
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from benchmarks import real
from benchmarks.real_sets import RealSet
from kinran.base import encoding, frames
from kinran.base.files import write_json

Array = NDArray[np.float64]
Scene = dict[str, Any]

SIDE, SAMPLES, DEPTH, SEED = 96, 64, 6, 5
"""Texels along a side, samples a pixel, and depth of the paths, so that light goes from part to part."""
GRID = 257
"""Vertices along a side of a relief."""
JUDGED, CAP = 40, 66.0
"""Lights that judge, spread at random over a cap of this many degrees."""
EXPOSED = (0.985, 0.8)
"""Quantile of the light that an exposure takes to a share of white: the brightest glints are saturated."""
RINGS = ((12, 6), (30, 12), (50, 20), (68, 26))
"""Polar angle of each ring of a dome in degrees, and its lights."""
SPIRAL = (56, 78.0)
"""Lights of a dome without rings, and the polar angle of the last in degrees."""
OBJECTS = ("ring", "foil", "varnish", "paint")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--objects", nargs="+", choices=OBJECTS, default=OBJECTS, help="which (default: all)")
    parser.add_argument("--out", type=Path, required=True, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Render, measure, print a table, write JSON."""
    mi.set_variant("llvm_ad_rgb")
    rows: dict[str, Any] = {}
    for name in args.objects:
        with tempfile.TemporaryDirectory() as folder:
            for dome, made in rendered(scene(name, Path(folder))):
                rows[f"{name}, {dome}"] = row = real.measure(made)
                real.print_row(f"{name}, {dome}", row)
                write_json(args.out, {"sets": rows})


def rings() -> Array:
    """Directions (light, 3) of a dome of rings."""
    return np.concatenate(
        [
            frames.direction(np.full(count, np.radians(theta)), 2 * np.pi * np.arange(count) / count + 0.7 * k)
            for k, (theta, count) in enumerate(RINGS)
        ]
    )


def spiral() -> Array:
    """Directions (light, 3) of a dome without rings."""
    count, most = SPIRAL
    k = np.arange(count) + 0.5
    return frames.direction(np.radians(most) * np.sqrt(k / count), k * np.pi * (3 - 5**0.5))


def rendered(objects: Scene) -> Iterator[tuple[str, RealSet]]:
    """Photographs in 8 bits of objects under each dome, with lights held out that are at no place of either."""
    rng = np.random.default_rng(SEED)
    cosine = 1 - rng.random(JUDGED) * (1 - np.cos(np.radians(CAP)))
    judging = frames.direction(np.arccos(cosine), 2 * np.pi * rng.random(JUDGED))
    for name, dome in (("rings", rings()), ("spiral", spiral())):
        lights = np.concatenate([dome, judging])
        light = photographed(objects, lights)
        quantile, share = EXPOSED
        code = np.rint(encoding.to_srgb(np.clip(light * (share / np.quantile(light, quantile)), 0, 1)) * 255) / 255
        picture = encoding.parse("srgb").decode(code.astype(np.float32))
        yield name, RealSet(picture, code >= 1, lights, np.arange(len(lights)) >= len(dome), "srgb")


def photographed(objects: Scene, lights: Array) -> NDArray[np.float32]:
    """Light (light, y, x, 3) from objects within ±1, row 0 at the bottom, under lights (light, 3)."""
    world = mi.ScalarTransform4f()
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": DEPTH},
            "camera": {
                "type": "orthographic",
                "to_world": world.look_at([0, 0, 5], [0, 0, 0], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}},
            },
            "lamp": {"type": "directional", "to_world": world, "irradiance": np.pi},
            **objects,
        }
    )
    known, pictures = mi.traverse(scene), []
    for k, (x, y, z) in enumerate(lights.tolist()):
        up = [0, 1, 0] if abs(y) < 0.9 else [1, 0, 0]
        known["lamp.to_world"] = mi.Transform4f().look_at([x, y, z], [0, 0, 0], up)
        known.update()
        pictures.append(np.array(mi.render(scene, spp=SAMPLES, seed=k), np.float32)[::-1, :, :3])
    return np.stack(pictures)


def scene(name: str, folder: Path) -> Scene:
    """Objects of Mitsuba's own materials."""
    gold = {"type": "roughconductor", "material": "Au", "alpha": 0.15, "distribution": "ggx"}
    silver = {"type": "roughconductor", "material": "Ag", "alpha": 0.3, "distribution": "ggx"}
    if name == "ring":
        bead = {"type": "sphere", "center": [0.7, -0.65, 0.2], "radius": 0.2, "bsdf": silver}
        board = {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": colour(0.35, 0.3, 0.28)}}
        return {"board": board, "ring": torus(folder, 0.55, 0.16) | {"bsdf": gold}, "bead": bead}
    if name == "foil":
        return {"foil": relief(folder, (0.05, 10), (0.012, 3)) | {"bsdf": silver}}
    if name == "varnish":
        varnish = {"type": "principled", "base_color": colour(0.5, 0.15, 0.1), "roughness": 0.35, "specular": 0.6}
        return {"varnish": relief(folder, (0.12, 22), (0.006, 2)) | {"bsdf": varnish | {"clearcoat": 0.6}}}
    painted = np.clip(0.45 + 0.2 * noise(14, 8)[..., None] * [0.8, 1.0, 1.1], 0.05, 0.9).astype(np.float32)
    texture = {"type": "bitmap", "bitmap": mi.Bitmap(painted), "raw": True}
    paint = {"type": "roughplastic", "alpha": 0.12, "diffuse_reflectance": texture}
    return {"paint": relief(folder, (0.03, 6)) | {"bsdf": paint}}


def colour(red: float, green: float, blue: float) -> Scene:
    """Colour in Rec. 709."""
    return {"type": "rgb", "value": [red, green, blue]}


def noise(scale: float, seed: int) -> Array:
    """Noise (GRID, GRID) of variance 1, smooth over `scale` vertices."""
    square = np.fft.fftfreq(GRID)[:, None] ** 2 + np.fft.fftfreq(GRID) ** 2
    waves = np.fft.fft2(np.random.default_rng(seed).normal(size=(GRID, GRID)))
    smooth = np.fft.ifft2(waves * np.exp(-2 * (np.pi * scale) ** 2 * square)).real
    return np.asarray(smooth / smooth.std())


def relief(folder: Path, *layers: tuple[float, float]) -> Scene:
    """Sheet over ±1, as high as layers of noise, each of a height and a scale."""
    x = np.linspace(-1, 1, GRID)
    height = sum(rise * noise(scale, seed) for seed, (rise, scale) in enumerate(layers))
    vertices = np.stack([*np.meshgrid(x, x), np.broadcast_to(height, (GRID, GRID))], -1)
    k = np.arange(GRID * GRID).reshape(GRID, GRID)
    return mesh(folder, vertices, k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:])


def torus(folder: Path, radius: float, thickness: float) -> Scene:
    """Ring that lies on z = 0."""
    a, b = np.meshgrid(*(np.arange(n) * 2 * np.pi / n for n in (96, 48)), indexing="ij")
    away = radius + thickness * np.cos(b)
    vertices = np.stack([away * np.cos(a), away * np.sin(a), thickness * (1 + np.sin(b))], -1)
    k = np.arange(a.size).reshape(a.shape)
    return mesh(folder, vertices, k, np.roll(k, -1, 0), np.roll(k, -1, 1), np.roll(k, -1, (0, 1)))


def mesh(folder: Path, vertices: Array, *corners: NDArray[np.intp]) -> Scene:
    """Shape of vertices (m, n, 3), and of quads by four corners."""
    a, b, c, d = (corner.reshape(-1) for corner in corners)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([b, d, c], 1)]).astype(np.uint32)
    made = mi.Mesh("mesh", vertices.size // 3, len(faces), has_vertex_texcoords=True)
    known = mi.traverse(made)
    known["vertex_positions"] = vertices.reshape(-1).astype(np.float32)
    known["vertex_texcoords"] = ((vertices[..., :2] + 1) / 2).reshape(-1).astype(np.float32)
    known["faces"] = faces.reshape(-1)
    known.update()
    made.write_ply(str(folder / "mesh.ply"))
    return {"type": "ply", "filename": str(folder / "mesh.ply")}
