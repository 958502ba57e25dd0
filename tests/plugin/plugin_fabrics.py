"""Materials that the plugin's tests use."""

from typing import Any

import numpy as np

from kinran_bsdf import Material
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
