"""The weft is +u and the warp +v on the surface itself, whatever the mesh and its layout."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from kinran_bsdf import Material, write_material


def weft_lobe(path: Path, fabric: Callable[..., Material]) -> None:
    """One texel that mirrors N into +X, the weft, and less so into +Y."""
    m = fabric(size=(1, 1))
    shape = {"x": 0.4, "y": 0.15, "xx": 0.01, "xy": 0.0, "yy": 0.01}
    for name, value in shape.items():
        m.channels[f"lobe1.{name}"][:] = value
    m.channels["diffuse.amplitude"][:] = 0
    write_material(path, m)


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float u
property float v
element face 2
property list uchar int vertex_indices
end_header
{vertices}
3 0 1 2
3 0 2 3
"""
CORNERS = [(-1, -1), (1, -1), (1, 1), (-1, 1)]


def square(kind: str, tmp_path: Path, uv: Callable[[float, float], tuple[float, float]]) -> dict[str, Any]:
    """Square in the plane z = 0, facing +z, whose texture coordinates are uv(s, t) for s, t in [0, 1]."""
    corners = [(x, y, *uv((x + 1) / 2, (y + 1) / 2)) for x, y in CORNERS]
    if kind == "rectangle":
        return {"type": "rectangle"}
    path = tmp_path / f"square.{kind}"
    if kind == "ply":
        path.write_text(PLY.format(vertices="\n".join(f"{x} {y} 0 {u} {v}" for x, y, u, v in corners)))
        return {"type": "ply", "filename": str(path)}
    lines = [f"v {x} {y} 0\nvt {u} {v}" for x, y, u, v in corners]
    path.write_text("\n".join(lines) + "\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n")
    return {"type": "obj", "filename": str(path), "flip_tex_coords": False}


LAYOUTS: dict[str, tuple[Callable[[float, float], tuple[float, float]], tuple[int, int], tuple[int, int]]] = {
    "straight": (lambda s, t: (s, t), (1, 0), (0, 1)),
    "turned by 90°": (lambda s, t: (t, 1 - s), (0, 1), (-1, 0)),
    "mirrored": (lambda s, t: (1 - s, t), (-1, 0), (0, 1)),
    "flipped": (lambda s, t: (s, 1 - t), (1, 0), (0, -1)),
}


@pytest.mark.parametrize(
    ("kind", "layout"), [("rectangle", "straight"), *((kind, layout) for kind in ("ply", "obj") for layout in LAYOUTS)]
)
def test_lobe_leans_along_the_weft_whatever_the_uv_layout(
    jit: str, fabric: Callable[..., Material], tmp_path: Path, kind: str, layout: str
) -> None:
    """X is +u and Y is +v on the surface itself, on mirrored layouts too."""
    uv, x, y = LAYOUTS[layout]
    weft_lobe(tmp_path / "a.exr", fabric)
    scene = mi.load_dict(
        {
            "type": "scene",
            "s": square(kind, tmp_path, uv) | {"bsdf": {"type": "kinran", "filename": str(tmp_path / "a.exr")}},
        }
    )
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.2, 3), mi.Vector3f(0, 0, -1)))
    assert brightest(si) == pytest.approx(expected_slope(x, y), abs=0.02)


def expected_slope(x: tuple[int, int], y: tuple[int, int]) -> list[float]:
    return [0.4 * x[0] + 0.15 * y[0], 0.4 * x[1] + 0.15 * y[1]]


def brightest(si: Any) -> list[float]:
    """World slope of the half vector at which the surface seen from +z is brightest."""
    s, t = np.meshgrid(np.linspace(-0.6, 0.6, 121), np.linspace(-0.6, 0.6, 121))
    h = np.stack([s, t, np.ones_like(s)], -1).reshape(-1, 3)
    h /= np.linalg.norm(h, axis=1, keepdims=True)
    light = 2 * h[:, 2:] * h - np.array([0, 0, 1])
    wo = si.to_local(mi.Vector3f(light.T.astype(np.float32)))
    value = np.array(
        si.bsdf().eval(mi.BSDFContext(), dr.gather(mi.SurfaceInteraction3f, si, dr.zeros(mi.UInt32, len(h))), wo).x
    )
    best = h[value.argmax()]
    return [float(best[0] / best[2]), float(best[1] / best[2])]


@pytest.mark.parametrize("angle", [90.0, 30.0, 180.0])
def test_to_uv_turns_the_weft_with_the_map(
    jit: str, fabric: Callable[..., Material], tmp_path: Path, angle: float
) -> None:
    weft_lobe(tmp_path / "a.exr", fabric)
    transform = mi.ScalarTransform3f().rotate(angle)
    bsdf = {"type": "kinran", "filename": str(tmp_path / "a.exr"), "to_uv": transform}
    scene = mi.load_dict({"type": "scene", "s": {"type": "rectangle", "bsdf": bsdf}})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.2, 3), mi.Vector3f(0, 0, -1)))
    c, s = np.cos(np.radians(-angle)), np.sin(np.radians(-angle))  # the map turns against its coordinates
    assert brightest(si) == pytest.approx([0.4 * c - 0.15 * s, 0.4 * s + 0.15 * c], abs=0.02)
