"""Materials that the plugin's tests use, and how they look a BSDF up."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from kinran_bsdf import Material, colours
from kinran_bsdf.material import COLOUR


def random_material(
    model: str = "slope",
    lobes: int = 1,
    tail: str = "gaussian",
    size: tuple[int, int] = (5, 7),
    seed: int = 0,
) -> Material:
    """Material of random texels, with colours inside Rec.709 so that nothing is clamped on loading."""
    rng = np.random.default_rng(seed)
    maps = {"label": np.zeros(size), "bound": np.ones(size)}
    for name, most in [("diffuse", 0.2)] + [(f"lobe{k + 1}", 0.6) for k in range(lobes)]:
        for c in "RGB":
            maps[f"{name}.{c}"] = rng.uniform(0.6, 1, size)
        maps[f"{name}.amplitude"] = most * rng.uniform(0.5, 1, size)
    maps["diffuse.x"], maps["diffuse.y"] = rng.uniform(-0.4, 0.4, (2, *size))
    for k in range(1, lobes + 1):
        maps |= {f"lobe{k}.{name}": value for name, value in _random_shape(model, rng, size).items()}
    return Material(
        channels={name: value.astype(np.float32) for name, value in maps.items()},
        model=model,
        tail=tail,
        lobes=lobes,
        regions=[{"label": 0, "name": "cloth", "model": model}],
        colour=COLOUR,
        from_stack=np.eye(3),
        texel_mm=0.1,
        source="0" * 64,
        theta_max=1.4,
    )


def _random_shape(model: str, rng: np.random.Generator, size: tuple[int, int]) -> dict[str, Any]:
    if model == "takeda2008":
        limits = {"theta": (0, 0.7), "phi": (0, 2 * np.pi), "dt": (0.05, 0.4), "dp": (0.1, 1.5)}
        return {name: rng.uniform(*limit, size) for name, limit in limits.items()}
    a, b = rng.uniform(0.05, 0.5, (2, *size))
    xx, xy, yy = widths(a, b, rng.uniform(0, np.pi, size))
    x, y = rng.uniform(-0.5, 0.5, (2, *size))
    return {"x": x, "y": y, "xx": xx, "xy": xy, "yy": yy}


def widths(a: Any, b: Any, angle: Any) -> tuple[Any, Any, Any]:
    """Squared-width matrix with the widths a along `angle` and b across."""
    c, s = np.cos(angle), np.sin(angle)
    return a * a * c * c + b * b * s * s, (a * a - b * b) * c * s, a * a * s * s + b * b * c * c


def load(path: Path, **properties: Any) -> Any:
    return mi.load_dict({"type": "kinran", "filename": str(path), **properties})


def interaction(uv: np.ndarray, view: np.ndarray) -> Any:
    """Surface interactions at uv (n, 2), seen from view (n, 3); one in scalar variants."""
    if "scalar" in mi.variant():
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.uv, si.wi = uv[0].tolist(), view[0].tolist()
        return si
    si = dr.zeros(mi.SurfaceInteraction3f, len(uv))
    si.uv = mi.Point2f(uv.T.astype(np.float32))
    si.wi = mi.Vector3f(view.T.astype(np.float32))
    return si


def evaluate(bsdf: Any, uv: np.ndarray, view: np.ndarray, light: np.ndarray) -> np.ndarray:
    """T of n texels, views and lights, (n, bands)."""
    context = mi.BSDFContext()
    if "scalar" in mi.variant():
        rows = [
            bsdf.eval(context, interaction(uv[k : k + 1], view[k : k + 1]), mi.Vector3f(light[k].tolist()))
            for k in range(len(uv))
        ]
        return np.array([np.array(row).ravel() for row in rows])
    value = bsdf.eval(context, interaction(uv, view), mi.Vector3f(light.T.astype(np.float32)))
    return np.array(value).T.reshape(len(uv), -1)


def centres(size: tuple[int, int]) -> np.ndarray:
    """Texture coordinates of texel centres, row by row, (H·W, 2)."""
    y, x = np.mgrid[: size[0], : size[1]]
    return np.stack([(x.ravel() + 0.5) / size[1], (y.ravel() + 0.5) / size[0]], -1)


def in_variant(acescg: np.ndarray) -> np.ndarray:
    rec709 = acescg @ colours.TO_REC709.T
    return rec709 @ colours.LUMINANCE[:, None] if mi.is_monochromatic else rec709
