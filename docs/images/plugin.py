"""Draw the pictures of docs/plugin.md: one wavy cloth in each model (python docs/images/plugin.py)."""

import tempfile
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import kinran_bsdf
from kinran_bsdf import Material
from kinran_bsdf.material import COLOUR

HERE = Path(__file__).parent
SIZE = 96


def brocade(model: str, lobes: int, tail: str) -> Material:
    """Flat gold strips in weft direction that float over a red warp in a twill."""
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32)
    strip, across = y // 8, (y % 8 + 0.5) / 8 - 0.5
    gold = ((x + 24 * strip) % 96 < 60) & (np.abs(across) < 0.42)
    along = ((x + 24 * strip) % 96) / 60 - 0.5
    maps = {"label": gold.astype(np.float32), "bound": np.ones_like(x)}
    silk = 0.7 * np.sin(2 * np.pi * x / 4)
    maps |= {"diffuse.x": np.where(gold, 0, silk), "diffuse.y": 0 * x}
    for c, on_gold, on_silk in zip("RGB", (0.6, 0.4, 0.15), (0.45, 0.06, 0.06), strict=True):
        maps[f"diffuse.{c}"] = np.where(gold, on_gold, on_silk)
    maps["diffuse.amplitude"] = np.where(gold, 0.12, 0.3)
    slope_x, slope_y = 0.35 * along, 0.25 * across
    for k in range(1, lobes + 1):
        for c, value in zip("RGB", (1.0, 0.72, 0.32), strict=True):
            maps[f"lobe{k}.{c}"] = value + 0 * x
        maps[f"lobe{k}.amplitude"] = np.where(gold, (2.0, 0.5)[k - 1], 0)
        a, b = ((0.12, 0.2), (0.3, 0.5))[k - 1]
        if model == "takeda2008":
            theta = np.arctan(np.hypot(slope_x, slope_y))
            shape = {"theta": theta, "phi": np.arctan2(slope_y, slope_x), "dt": a + 0 * x, "dp": 1.0 + 0 * x}
        else:
            shape = {"x": slope_x, "y": slope_y, "xx": a * a + 0 * x, "xy": 0 * x, "yy": b * b + 0 * x}
        maps |= {f"lobe{k}.{name}": value for name, value in shape.items()}
    return Material(
        channels={name: np.asarray(value, np.float32) for name, value in maps.items()},
        model=model,
        tail=tail,
        lobes=lobes,
        regions=[
            {"label": 0, "name": "silk", "model": "lambert"},
            {"label": 1, "name": "gold", "model": model},
        ],
        colour=COLOUR,
        from_stack=np.eye(3),
        texel_mm=0.1,
        source="0" * 64,
        theta_max=float(np.radians(80)),
    )


def cloth(path: Path, cells: int = 200) -> None:
    """Draped sheet whose +u is the weft."""
    u, v = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1))
    z = 0.12 * np.sin(9 * u + 2 * v) * (0.4 + v) + 0.05 * np.sin(5 * v)
    mesh = mi.Mesh("cloth", u.size, 2 * cells * cells, has_vertex_texcoords=True)
    p = mi.traverse(mesh)
    p["vertex_positions"] = np.stack([2 * u - 1, 2 * v - 1, z], -1).ravel().astype(np.float32)
    p["vertex_texcoords"] = np.stack([u, v], -1).ravel().astype(np.float32)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    p["faces"] = np.stack([i, i + 1, i + cells + 2, i, i + cells + 2, i + cells + 1], -1).ravel().astype(np.uint32)
    p.update()
    mesh.write_ply(str(path))


def scene(mesh: Path, material: Path, **integrator: Any) -> Any:
    turn = mi.ScalarTransform4f()
    bsdf = {"type": "kinran", "filename": str(material), "to_uv": turn.scale([8, 8, 1])}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator or {"type": "path", "max_depth": 5},
            "sensor": {
                "type": "perspective",
                "fov": 32,
                "to_world": turn.look_at(origin=[0.3, -2.4, 2.4], target=[0, 0.05, 0], up=[0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 276, "height": 184},
            },
            "lamp": {
                "type": "rectangle",
                "to_world": turn.look_at(origin=[-0.6, 1.6, 2.2], target=[0, 0, 0], up=[0, 1, 0]) @ turn.scale(0.35),
                "emitter": {"type": "area", "radiance": 22.0},
            },
            "sky": {"type": "constant", "radiance": 0.25},
            "cloth": {"type": "ply", "filename": str(mesh), "bsdf": {"type": "twosided", "bsdf": bsdf}},
        }
    )


def main() -> None:
    mi.set_variant("llvm_ad_rgb")
    kinds = {
        "takeda2008": ("takeda2008", 1, "gaussian"),
        "slope": ("slope", 1, "gaussian"),
        "slope-ggx": ("slope", 1, "ggx"),
        "slope-two-lobes": ("slope", 2, "gaussian"),
        "lambert": ("lambert", 0, "gaussian"),
    }
    with tempfile.TemporaryDirectory() as folder:
        mesh = Path(folder) / "cloth.ply"
        cloth(mesh)
        for name, kind in kinds.items():
            material = Path(folder) / f"{name}.exr"
            kinran_bsdf.write_material(material, brocade(*kind))
            mi.util.write_bitmap(str(HERE / f"plugin-{name}.png"), mi.render(scene(mesh, material), spp=256))
        distance = mi.render(scene(mesh, material, type="kinran_measured"), spp=16)[..., -3]
        mi.util.write_bitmap(str(HERE / "plugin-measured-distance.png"), np.array(distance) / (np.pi / 2))


if __name__ == "__main__":
    main()
