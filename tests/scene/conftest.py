from collections.abc import Callable, Iterator
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from kinran.scene.mesh import write_mesh
from kinran_bsdf import Material, write_material


@pytest.fixture
def scalar() -> None:
    mi.set_variant("scalar_rgb")


@pytest.fixture
def llvm() -> Iterator[None]:
    mi.set_variant("llvm_ad_rgb")
    yield
    dr.sync_thread()


@pytest.fixture
def make_material(tmp_path: Path) -> Callable[..., Path]:
    """Write a material of grey diffuse albedo (y, x), and where a label has a lobe, one of mean slope (x, y)."""

    def make(
        albedo: np.ndarray,
        labels: np.ndarray | None = None,
        models: tuple[str, ...] = ("lambert",),
        slope: tuple[float, float] = (0.0, 0.0),
        texel_mm: float | None = None,
        name: str = "material",
    ) -> Path:
        one = np.ones(albedo.shape, np.float32)
        labels = np.zeros(albedo.shape) if labels is None else labels
        lobed = np.array([model != "lambert" for model in models])[labels.astype(int)]
        values = {
            "label": labels,
            "bound": 1,
            "diffuse.amplitude": albedo / np.pi,
            "diffuse.x": 0,
            "diffuse.y": 0,
        }
        values |= {f"diffuse.{c}": 1 for c in "RGB"}
        lobes = int(lobed.any())
        if lobes:
            shape = {"x": slope[0], "y": slope[1], "xx": 0.02, "xy": 0, "yy": 0.02}
            values |= {f"lobe1.{c}": 1 for c in "RGB"} | {f"lobe1.{k}": v for k, v in shape.items()}
            values["lobe1.amplitude"] = lobed * 0.5
        regions = [{"label": k, "name": f"r{k}", "model": model} for k, model in enumerate(models)]
        material = Material(
            channels={key: np.asarray(value * one, np.float32) for key, value in values.items()},
            model="slope" if lobes else "lambert",
            tail="gaussian",
            lobes=lobes,
            regions=regions,
            colour="lin_ap1_scene",
            from_stack=np.eye(3),
            texel_mm=texel_mm,
            source="",
            theta_max=1.4,
        )
        write_material(tmp_path / f"{name}.exr", material)
        return tmp_path / f"{name}.exr"

    return make


@pytest.fixture
def flat_mesh(tmp_path: Path) -> Path:
    """A flat panel, 60 × 90 mm, hung up."""
    uv = np.array([[0, 0], [60, 0], [60, 90], [0, 90]], float)
    vertices = np.column_stack([uv - [30, 45], np.zeros(4)])
    write_mesh(tmp_path / "flat.ply", vertices, np.array([[0, 1, 2], [0, 2, 3]]), uv)
    return tmp_path / "flat.ply"
