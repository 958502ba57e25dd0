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


def quilt(path: Path, light: tuple[float, float]) -> Any:
    """The fabric four times, turned by 90° each, seen from N under one lamp: four lights whose pixels are texels."""
    polar, azimuth = np.radians(light)
    towards = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    turn = mi.ScalarTransform4f()
    there = turn.look_at(origin=[0, 0, 4], target=[0, 0, 0], up=[0, 1, 0])
    squares: dict[str, Any] = {}
    for k in range(4):
        place = turn.translate([2 * (k % 2) - 1, 2 * (k // 2) - 1, 0]).rotate([0, 0, 1], 90 * k)
        squares[f"square{k}"] = {"type": "rectangle", "to_world": place, "bsdf": {"type": "ref", "id": "cloth"}}
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "prb", "max_depth": 2},
            "sensor": {
                "type": "orthographic",
                "to_world": there.scale([-2, 2, 1]),
                "film": {"type": "hdrfilm", "width": 32, "height": 32, "rfilter": {"type": "box"}},
            },
            "light": {"type": "directional", "irradiance": 3.0, "direction": [-float(v) for v in towards]},
            "cloth": {"type": "kinran", "filename": str(path), "filter": "nearest"},
            **squares,
        }
    )


def test_gradients_recover_a_map_from_renders(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Colours, slopes and widths of 16 × 16 lobes, 24 lights: to 12, 10 and 50 % of what one start for all is off."""
    m, rng, size = fabric(size=(16, 16)), np.random.default_rng(1), (16, 16)
    for name, (low, high) in {"x": (-0.3, 0.3), "y": (-0.3, 0.3), "xx": (0.05, 0.15), "yy": (0.05, 0.15)}.items():
        m.channels[f"lobe1.{name}"][:] = rng.uniform(low, high, size)
    m.channels["lobe1.xy"][:] = rng.uniform(-0.03, 0.03, size)
    write_material(tmp_path / "a.exr", m)
    frames = [quilt(tmp_path / "a.exr", light) for light in ((12, 20), (40, 45), (25, 65), (60, 20), (35, 0), (50, 70))]
    pictures = [mi.render(frame, spp=1) for frame in frames]
    parameters = [mi.traverse(frame) for frame in frames]
    right = np.array(parameters[0]["cloth.maps"])  # diffuse RGB, x, y, lobe RGB, x, y, xx, xy, yy
    start = np.array([*right[..., 5:8].mean((0, 1)) * 0.7, 0, 0, 0.1, 0, 0.1])
    optimiser = mi.ad.Adam(lr=0.02)
    for k, value in enumerate([*start[:5], np.sqrt(0.1), 0, np.sqrt(0.1)]):  # widths by their Cholesky factor
        optimiser[f"p{k}"] = dr.full(mi.Float, float(value), right[..., 0].size)
    known = [mi.Float(right[..., k].ravel()) for k in range(5)]

    def maps() -> Any:
        *others, a, b, c = (optimiser[f"p{k}"] for k in range(8))
        return mi.TensorXf(dr.ravel(mi.ArrayXf([*known, *others, a * a, a * b, b * b + c * c])), shape=right.shape)

    steps = 60
    for step in range(steps):
        optimiser.set_learning_rate(0.01 * (1 + np.cos(np.pi * step / steps)) + 0.0005)
        k = step % len(frames)
        parameters[k]["cloth.maps"] = maps()
        parameters[k].update()
        error = dr.square(mi.render(frames[k], parameters[k], spp=1, seed=step) - pictures[k]) / (pictures[k] + 0.05)
        dr.backward(dr.mean(error, axis=None))
        optimiser.step()
    before, after = np.abs(start - right[..., 5:]), np.abs(np.array(maps()) - right)[..., 5:]
    for part, bound in ((slice(3), 0.12), (slice(3, 5), 0.1), (slice(5, 8), 0.5)):
        assert after[..., part].mean() < bound * before[..., part].mean()


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
