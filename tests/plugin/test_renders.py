"""Renders against stored ones, by a Z-test on each pixel.

After a change that is meant to be seen, write the references anew: KINRAN_WRITE_REFERENCES=1 pytest tests/plugin.
"""

import os
from collections.abc import Callable
from pathlib import Path
from statistics import NormalDist
from typing import Any

import mitsuba as mi
import numpy as np
import pytest

from kinran_bsdf import Material, write_material

REFERENCES = Path(__file__).parent / "references"
CASES = {
    "takeda2008": ("takeda2008", 1, "gaussian"),
    "slope": ("slope", 1, "gaussian"),
    "slope-two-ggx": ("slope", 2, "ggx"),
    "lambert": ("lambert", 0, "gaussian"),
}


def scene(path: Path, **properties: Any) -> Any:
    """Ball and ground of one fabric under a lamp and a sky, several bounces."""
    bsdf = {"type": "kinran", "filename": str(path), "filter": "nearest", "back": 0.2, **properties}
    turn = mi.ScalarTransform4f()
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "moment", "path": {"type": "path", "max_depth": 4}},
            "sensor": {
                "type": "perspective",
                "to_world": turn.look_at(origin=[0, -3.2, 2], target=[0, 0, 0.4], up=[0, 0, 1]),
                "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
            },
            "lamp": {
                "type": "sphere",
                "center": [1.5, -1, 3],
                "radius": 0.4,
                "emitter": {"type": "area", "radiance": 15.0},
            },
            "sky": {"type": "constant", "radiance": 0.3},
            "ball": {"type": "sphere", "radius": 0.8, "center": [0, 0, 0.8], "bsdf": bsdf},
            "ground": {"type": "rectangle", "to_world": turn.scale(3), "bsdf": bsdf},
        }
    )


def moments(frame: Any, spp: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean of each pixel and variance of its samples."""
    image = np.array(mi.render(frame, spp=spp, seed=seed), np.float64)
    mean, square = image[..., :3], image[..., 3:6]
    return mean, np.maximum(square - mean**2, 0)


def rejected(mean: np.ndarray, spp: int, reference: np.ndarray, spread: np.ndarray, reference_spp: int) -> float:
    """Share of pixels whose difference has a probability under 1 %, corrected for their number (Šidák)."""
    error = np.sqrt(spread * (1 / spp + 1 / reference_spp)) + 1e-5
    limit = NormalDist().inv_cdf(1 - (1 - 0.99 ** (1 / mean.size)) / 2)
    return float((np.abs(mean - reference) / error > limit).mean())


SPP, REFERENCE_SPP = 256, 4096


@pytest.mark.parametrize("case", CASES)
def test_render_is_the_stored_one(jit: str, fabric: Callable[..., Material], tmp_path: Path, case: str) -> None:
    """A fabric whose lobe leans 10° further, in the same test, is told from it."""
    m = fabric(*CASES[case], size=(8, 8), seed=3)
    write_material(tmp_path / "a.exr", m)
    stored = REFERENCES / f"{case}.exr"
    if os.environ.get("KINRAN_WRITE_REFERENCES"):
        stored.parent.mkdir(exist_ok=True)
        pixels = np.concatenate(moments(scene(tmp_path / "a.exr"), REFERENCE_SPP, 99), -1).astype(np.float32)
        names = [f"{part}.{c}" for part in ("mean", "variance") for c in "RGB"]
        mi.Bitmap(pixels, mi.Bitmap.PixelFormat.MultiChannel, names).write(str(stored))
    bitmap = mi.Bitmap(str(stored))
    names = [field.name for field in bitmap.struct_()]
    planes = {name: np.array(bitmap, np.float64)[..., k] for k, name in enumerate(names)}
    reference = np.stack([planes[f"mean.{c}"] for c in "RGB"], -1)
    spread = np.stack([planes[f"variance.{c}"] for c in "RGB"], -1)
    mean, _ = moments(scene(tmp_path / "a.exr"), SPP, 5)
    assert rejected(mean, SPP, reference, spread, REFERENCE_SPP) < 0.01
    if case == "lambert":
        m.channels["diffuse.x"][:] += np.float32(np.tan(np.radians(10)))
    elif case == "takeda2008":
        m.channels["lobe1.theta"][:] += np.float32(np.radians(10))
    else:
        m.channels["lobe1.x"][:] += np.float32(np.tan(np.radians(10)))
    write_material(tmp_path / "b.exr", m)
    mean, _ = moments(scene(tmp_path / "b.exr"), 16 * SPP, 6)
    assert rejected(mean, 16 * SPP, reference, spread, REFERENCE_SPP) > 0.02
