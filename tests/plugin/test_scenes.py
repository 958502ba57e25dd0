"""Whole scenes: loading, compiling, differentiating."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from kinran_bsdf import Material, write_material


def scene(bsdf: dict[str, Any], size: int = 24) -> dict[str, Any]:
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 4},
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, -2, 3], target=[0, 0, 0], up=[0, 0, 1]),
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}},
        },
        "light": {"type": "point", "position": [1, 1, 3], "intensity": 20.0},
        "sky": {"type": "constant", "radiance": 0.2},
        "cloth": {"type": "rectangle", "bsdf": bsdf},
    }


def test_xml_dict_and_twosided_render_alike(variant_any: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", fabric())
    bsdf = {"type": "twosided", "bsdf": {"type": "kinran", "filename": str(tmp_path / "a.exr")}}
    size = 4 if "scalar" in variant_any else 24
    there = mi.render(mi.load_dict(scene(bsdf, size)), spp=4, seed=1)
    (tmp_path / "scene.xml").write_text(f"""<scene version="3.0.0">
      <integrator type="path"><integer name="max_depth" value="4"/></integrator>
      <sensor type="perspective">
        <transform name="to_world"><lookat origin="0,-2,3" target="0,0,0" up="0,0,1"/></transform>
        <film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/>
          <rfilter type="box"/></film>
      </sensor>
      <emitter type="point"><point name="position" x="1" y="1" z="3"/>
        <float name="intensity" value="20"/></emitter>
      <emitter type="constant"><float name="radiance" value="0.2"/></emitter>
      <shape type="rectangle">
        <bsdf type="twosided"><bsdf type="kinran"><string name="filename" value="a.exr"/></bsdf></bsdf>
      </shape>
    </scene>""")
    here = mi.render(mi.load_file(str(tmp_path / "scene.xml")), spp=4, seed=1)
    there, here = np.array(there), np.array(here)
    assert np.isfinite(there).all()
    assert there.mean() > 0.01
    np.testing.assert_allclose(here, there, rtol=1e-3, atol=1e-4)


def test_repeated_renders_compile_nothing_new(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Other maps, sizes, layouts and ranges of lights, same kernels."""
    for k in range(3):
        write_material(tmp_path / f"{k}.exr", replace(fabric(seed=k, size=(5 + k, 7)), theta_max=1.49 + 0.01 * k))
    kernels = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for k in range(3):
            bsdf = {"type": "kinran", "filename": str(tmp_path / f"{k}.exr")}
            bsdf["to_uv"] = mi.ScalarTransform4f().scale([k + 2, 3, 1])
            frame = scene(bsdf)
            del frame["sky"]  # a kernel holds its number among all emitters that are alive
            mi.render(mi.load_dict(frame), spp=2, seed=k)
            dr.eval()
            kernels.append({h["hash"] for h in dr.kernel_history() if h["type"] == dr.KernelType.JIT})
    assert kernels[0]
    assert kernels[0] >= kernels[1] | kernels[2]


def test_gradients_recover_a_map_from_renders(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """From two renders of a 2 × 2 fabric, gradient descent finds slopes that were off by 0.12."""
    m = fabric(size=(2, 2))
    m.channels["lobe1.xx"][:] = m.channels["lobe1.yy"][:] = 0.08
    m.channels["lobe1.xy"][:] = 0
    write_material(tmp_path / "a.exr", m)
    frames = []
    for position in ([1, 1, 3], [-1, 0.5, 3]):
        d = scene({"type": "kinran", "filename": str(tmp_path / "a.exr"), "filter": "nearest"}, 12)
        d["light"]["position"] = position
        d["integrator"] = {"type": "prb", "max_depth": 2}
        frames.append(mi.load_dict(d))
    truth = [mi.render(f, spp=64) for f in frames]
    parameters = [mi.traverse(f) for f in frames]
    key = "cloth.bsdf.maps"
    right = mi.TensorXf(parameters[0][key])
    wrong = np.array(right)
    columns = [8, 9]  # diffuse RGB, x, y, lobe RGB, then its x and y
    wrong[..., columns] += np.array([0.12, -0.1], np.float32)
    mask = np.zeros_like(wrong)
    mask[..., columns] = 1
    mask = mi.TensorXf(mask)
    optimiser = mi.ad.Adam(lr=0.03)
    optimiser["maps"] = mi.TensorXf(wrong)
    for step in range(45):
        if step == 30:
            optimiser.set_learning_rate(0.004)
        loss = 0
        for frame, p, image in zip(frames, parameters, truth, strict=True):
            p[key] = dr.lerp(right, optimiser["maps"], mask)
            p.update()
            loss += dr.mean(dr.square(mi.render(frame, p, spp=2, seed=step) - image), axis=None)
        dr.backward(loss)
        optimiser.step()
    found = np.array(optimiser["maps"])[..., columns]
    assert np.abs(found - np.array(right)[..., columns]).max() < 0.04


def test_jit_flags_change_nothing(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", fabric(lobes=2))
    images = []
    for on in (True, False):
        flags = (dr.JitFlag.SymbolicCalls, dr.JitFlag.OptimizeCalls, dr.JitFlag.SymbolicLoops)
        with dr.scoped_set_flag(flags[0], on), dr.scoped_set_flag(flags[1], on), dr.scoped_set_flag(flags[2], on):
            frame = mi.load_dict(scene({"type": "kinran", "filename": str(tmp_path / "a.exr")}, 8))
            images.append(np.array(mi.render(frame, spp=4, seed=1)))
    np.testing.assert_allclose(images[0], images[1], rtol=1e-4, atol=1e-5)


def test_a_whole_scene_of_fabrics_renders_in_one_kernel(
    jit: str, fabric: Callable[..., Material], tmp_path: Path
) -> None:
    """Six fabrics of three models in one scene, read in parallel: as if they stood alone."""
    kinds = [("slope", 1, "gaussian"), ("slope", 2, "ggx"), ("takeda2008", 1, "gaussian")] * 2
    squares: dict[str, Any] = {}
    for k, kind in enumerate(kinds):
        write_material(tmp_path / f"{k}.exr", fabric(*kind, seed=k))
        place = mi.ScalarTransform4f().translate([k % 3 - 1, k // 3 - 0.5, 0]).scale(0.4)
        bsdf = {"type": "kinran", "filename": str(tmp_path / f"{k}.exr")}
        squares[f"s{k}"] = {"type": "rectangle", "to_world": place, "bsdf": bsdf}
    lamp = scene({"type": "kinran"}, 32)
    del lamp["cloth"], lamp["sky"]
    image = np.array(mi.render(mi.load_dict(lamp | squares), spp=16, seed=2))
    alone = [np.array(mi.render(mi.load_dict(lamp | {name: s}), spp=16, seed=2)) for name, s in squares.items()]
    alone = np.sum(alone, 0)
    assert image.mean() > 0.01
    np.testing.assert_allclose(image, alone, rtol=1e-3, atol=1e-4)


def test_samples_of_a_frozen_scene_move_with_its_parameters(
    jit: str, fabric: Callable[..., Material], tmp_path: Path
) -> None:
    write_material(tmp_path / "a.exr", fabric())
    frame = mi.load_dict(scene({"type": "kinran", "filename": str(tmp_path / "a.exr")}))
    before = np.array(mi.render(frame, spp=4))
    p = mi.traverse(frame)
    p["cloth.bsdf.maps"] = p["cloth.bsdf.maps"] * 0.5
    p.update()
    assert np.array(mi.render(frame, spp=4)).mean() < before.mean()
