"""The integrator that says how far a pixel is from the measured view."""

from collections.abc import Callable
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from kinran_bsdf import Material, write_material


@pytest.mark.parametrize("twosided", [False, True])
def test_distance_label_and_bound_of_each_pixel(
    jit: str, fabric: Callable[..., Material], tmp_path: Path, twosided: bool
) -> None:
    m = fabric(size=(1, 1))
    m.channels["bound"][:], m.channels["label"][:] = 0.5, 3
    write_material(tmp_path / "a.exr", m)
    bsdf = {"type": "kinran", "filename": str(tmp_path / "a.exr")}
    scene = {
        "type": "scene",
        "integrator": {"type": "kinran_measured"},
        "sensor": {
            "type": "orthographic",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, -3, 4], target=[0, 0, 0], up=[0, 0, 1])
            @ mi.ScalarTransform4f().scale([2, 2, 1]),
            "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
        },
        "cloth": {"type": "rectangle", "bsdf": {"type": "twosided", "bsdf": bsdf} if twosided else bsdf},
        "other": {
            "type": "sphere",
            "radius": 0.5,
            "center": [1.4, 0, 0],
            "bsdf": {"type": "diffuse"},
        },
    }
    image = np.array(mi.render(mi.load_dict(scene), spp=1))
    distance, label, bound = np.moveaxis(image[..., -3:], -1, 0)
    middle = (4, 4)
    assert distance[middle] == pytest.approx(np.arctan2(3, 4), rel=1e-3)
    assert label[middle] == 3
    assert bound[middle] == 0.5
    assert distance[0, 0] == label[0, 0] == -1
    assert {-1.0} < set(np.unique(label)) <= {-1.0, 3.0}


def test_fabric_of_constants_has_a_distance_and_nothing_else(
    jit: str, fabric: Callable[..., Material], tmp_path: Path
) -> None:
    """Beside one that has a file: each is asked for everything."""
    write_material(tmp_path / "a.exr", fabric(size=(1, 1)))
    beside = {"type": "rectangle", "to_world": mi.ScalarTransform4f().translate([2, 0, 0])}
    scene = {
        "type": "scene",
        "integrator": {"type": "kinran_measured"},
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 3, "height": 3, "rfilter": {"type": "box"}},
        },
        "cloth": {"type": "rectangle", "bsdf": {"type": "kinran"}},
        "beside": beside | {"bsdf": {"type": "kinran", "filename": str(tmp_path / "a.exr")}},
    }
    distance, label, bound = np.array(mi.render(mi.load_dict(scene), spp=1))[1, 1, -3:]
    assert 0 <= distance < 0.2
    assert label == bound == -1


def test_bound_scales_what_is_rendered(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    m = fabric(size=(1, 1))
    write_material(tmp_path / "a.exr", m)
    m.channels["bound"][:] = 0.25
    write_material(tmp_path / "b.exr", m)
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.uv, si.wi = mi.Point2f(0.5, 0.5), mi.Vector3f(0, 0.6, 0.8)
    values = [
        np.array(
            mi.load_dict({"type": "kinran", "filename": str(tmp_path / f"{name}.exr")}).eval(
                mi.BSDFContext(), si, mi.Vector3f(0.6, 0, 0.8)
            )
        )
        for name in "ab"
    ]
    np.testing.assert_allclose(values[1], 0.25 * values[0], rtol=1e-5)
