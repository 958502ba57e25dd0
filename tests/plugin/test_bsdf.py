"""The BSDF: what is fitted is what is rendered, in each variant and on each kind of surface."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

from kinran_bsdf import Material, colours, models, write_material

CASES = [("slope", 1, "gaussian"), ("slope", 1, "ggx"), ("slope", 2, "ggx"), ("takeda2008", 1, "gaussian")]
CASES += [("lambert", 0, "gaussian")]


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


@pytest.mark.parametrize(("model", "lobes", "tail"), CASES)
def test_render_is_fit_at_the_measured_view(
    variant_rgb: str,
    fabric: Callable[..., Material],
    lights: np.ndarray,
    tmp_path: Path,
    model: str,
    lobes: int,
    tail: str,
) -> None:
    m = fabric(model, lobes, tail)
    write_material(tmp_path / "a.exr", m)
    lights = lights[:: 5 if "scalar" in variant_rgb else 1]
    uv = np.tile(centres(m.size), (len(lights), 1))
    light = np.repeat(lights, m.size[0] * m.size[1], 0)
    seen = evaluate(load(tmp_path / "a.exr"), uv, np.tile([0.0, 0.0, 1.0], (len(uv), 1)), light)
    fitted = in_variant(models.relight(m, lights).reshape(-1, 3) / np.pi)
    np.testing.assert_allclose(seen, fitted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("model", "lobes", "tail"), CASES)
def test_variants_agree_with_numpy_at_any_view(
    variant_any: str, fabric: Callable[..., Material], tmp_path: Path, model: str, lobes: int, tail: str
) -> None:
    """The same texel for random views and lights, against the reference in double precision."""
    m = fabric(model, lobes, tail)
    write_material(tmp_path / "a.exr", m)
    n = 40
    rng = np.random.default_rng(11)
    view, light = rng.normal(size=(2, n, 3))
    view[:, 2], light[:, 2] = np.abs(view[:, 2]) + 0.1, np.abs(light[:, 2]) + 0.1
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    uv = np.tile(centres(m.size)[9], (n, 1))
    expected, floor = np.zeros((n, 3)), models.grazing(m.theta_max)
    for k, (colour, shape) in enumerate(m.terms()):
        values = [float(v) for v in shape.reshape(-1, shape.shape[-1])[9]]
        if k == 0:
            factor = models.diffuse_lift(view.T, light.T, *values, floor)
        else:
            factor = models.lobe(m.model, m.tail, view.T, light.T, values, floor)
        expected += factor[:, None] * colour.reshape(-1, 3)[9]
    bsdf = load(tmp_path / "a.exr")
    if mi.is_spectral:
        pytest.skip("spectra are compared in test_colours.py")
    seen = evaluate(bsdf, uv, view, light)
    np.testing.assert_allclose(seen, in_variant(expected), rtol=3e-5, atol=1e-6)


def test_import_registers_every_later_variant() -> None:
    """In a process of its own: import before any variant, then switch to and fro."""
    code = """
import kinran_bsdf, mitsuba as mi
for variant in ("scalar_rgb", "scalar_spectral", "scalar_rgb"):
    mi.set_variant(variant)
    assert "slope" in str(mi.load_dict({"type": "kinran"})), variant
assert not [name for name in __import__("sys").modules if name == "kinran" or name.startswith("kinran.")]
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr


def test_flags_and_components(variant_any: str) -> None:
    flags = mi.BSDFFlags
    bsdf = mi.load_dict({"type": "kinran", "lobe2": 0.5, "back": 0.3})
    assert bsdf.component_count() == 4
    for k in (0, 1):
        assert mi.has_flag(bsdf.flags(k), flags.GlossyReflection)
        assert mi.has_flag(bsdf.flags(k), flags.Anisotropic)
        assert mi.has_flag(bsdf.flags(k), flags.FrontSide)
    assert mi.has_flag(bsdf.flags(2), flags.DiffuseReflection)
    assert mi.has_flag(bsdf.flags(3), flags.BackSide)
    assert mi.has_flag(bsdf.flags(), flags.SpatiallyVarying)
    assert not mi.has_flag(mi.load_dict({"type": "kinran"}).flags(), flags.BackSide)


@pytest.mark.parametrize(
    ("properties", "says"),
    [
        ({"model": "phong"}, "model 'phong' is not one of takeda2008, slope, lambert"),
        ({"tail": "cauchy"}, "tail 'cauchy' is not one of"),
        ({"filename": "none.exr"}, "none.exr: no such file"),
        ({"lobe1_z": 0.2}, "unreferenced"),
    ],
)
def test_bad_properties_are_refused(llvm: str, properties: dict[str, Any], says: str) -> None:
    with pytest.raises((ValueError, RuntimeError), match=says):
        mi.load_dict({"type": "kinran", **properties})


def test_angles_are_never_interpolated(llvm: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", fabric("takeda2008"))
    with pytest.raises((ValueError, RuntimeError), match="would average angles"):
        load(tmp_path / "a.exr", filter="bilinear")
    with pytest.raises((ValueError, RuntimeError), match="wrap_mode 'mirror'"):
        load(tmp_path / "a.exr", wrap_mode="mirror")


def test_constants_equal_a_map_of_them(llvm: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    m = fabric(size=(1, 1))
    write_material(tmp_path / "a.exr", m)
    properties: dict[str, Any] = {"type": "kinran"}
    for (colour, shape), name in zip(m.terms(), ("diffuse", "lobe1"), strict=True):
        rgb = (in_variant(colour[0, 0]) / 2).tolist()
        properties |= {name: {"type": "rgb", "value": rgb}, f"{name}_amplitude": 2.0}
        names = ("x", "y") if name == "diffuse" else ("x", "y", "xx", "xy", "yy")
        properties |= {f"{name}_{s}": float(v) for s, v in zip(names, shape[0, 0], strict=True)}
    rng = np.random.default_rng(2)
    directions = np.abs(rng.normal(size=(2, 50, 3)))
    view, light = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    uv = np.full((50, 2), 0.5)
    there = evaluate(mi.load_dict(properties), uv, view, light)
    np.testing.assert_allclose(there, evaluate(load(tmp_path / "a.exr"), uv, view, light), rtol=1e-4, atol=1e-6)


def test_textures_can_give_any_parameter(llvm: str) -> None:
    checker = {"type": "checkerboard", "color0": 0.4, "color1": 0.1}
    bsdf = mi.load_dict({"type": "kinran", "lobe1_x": checker, "lobe1_xx": 0.01, "lobe1_yy": 0.01, "diffuse": 0.0})
    n = [[0.0, 0.0, 1.0]]
    for uv, slope in (((0.25, 0.25), 0.1), ((0.75, 0.25), 0.4)):
        light = np.array([[2 * slope, 0, 1 - slope**2]]) / (1 + slope**2)  # its half vector has this slope
        assert evaluate(bsdf, np.array([uv]), np.array(n), light)[0, 0] == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_wrap_mode_and_to_uv(llvm: str, fabric: Callable[..., Material], tmp_path: Path, wrap: str) -> None:
    """A fabric laid out 3 × 2 times: row 0 of the map is v = 0, and beyond 1 it repeats or stays."""
    m = fabric(size=(4, 4))
    write_material(tmp_path / "a.exr", m)
    transform = mi.ScalarTransform3f().scale([3, 2])
    bsdf = load(tmp_path / "a.exr", to_uv=transform, wrap_mode=wrap, filter="nearest")
    n = np.array([[0.0, 0.0, 1.0]])
    map_ = in_variant(models.relight(m, n)[0] / np.pi)
    for uv in ((0.1, 0.2), (0.45, 0.7), (0.9, 0.9)):
        x, y = int(uv[0] * 12), int(uv[1] * 8)
        texel = map_[y % 4, x % 4] if wrap == "repeat" else map_[min(y, 3), min(x, 3)]
        np.testing.assert_allclose(evaluate(bsdf, np.array([uv]), n, n)[0], texel, rtol=1e-5)


def test_back_side_is_lambertian_and_absent_by_default(variant_rgb: str) -> None:
    behind = np.array([[0.0, 0.6, -0.8]])
    uv = np.array([[0.5, 0.5]])
    bsdf = mi.load_dict({"type": "kinran", "back": {"type": "rgb", "value": [0.5, 0.2, 0.1]}})
    np.testing.assert_allclose(
        evaluate(bsdf, uv, behind, behind)[0], 0.8 / np.pi * np.array([0.5, 0.2, 0.1]), rtol=1e-5
    )
    bs, weight = bsdf.sample(mi.BSDFContext(), interaction(uv, behind), 0.5, mi.Point2f(0.3, 0.6))
    assert np.array(bs.wo).ravel()[2] < 0
    np.testing.assert_allclose(np.array(weight).ravel(), [0.5, 0.2, 0.1], rtol=1e-5)
    assert evaluate(mi.load_dict({"type": "kinran"}), uv, behind, behind).max() == 0


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


@pytest.mark.parametrize("kind", ["rectangle", "ply", "obj"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_lobe_leans_along_the_weft_whatever_the_uv_layout(
    llvm: str, fabric: Callable[..., Material], tmp_path: Path, kind: str, layout: str
) -> None:
    """X is +u and Y is +v on the surface itself, on mirrored layouts too."""
    if kind == "rectangle" and layout != "straight":
        pytest.skip("a rectangle has one layout")
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
    llvm: str, fabric: Callable[..., Material], tmp_path: Path, angle: float
) -> None:
    weft_lobe(tmp_path / "a.exr", fabric)
    transform = mi.ScalarTransform3f().rotate(angle)
    bsdf = {"type": "kinran", "filename": str(tmp_path / "a.exr"), "to_uv": transform}
    scene = mi.load_dict({"type": "scene", "s": {"type": "rectangle", "bsdf": bsdf}})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.2, 3), mi.Vector3f(0, 0, -1)))
    c, s = np.cos(np.radians(-angle)), np.sin(np.radians(-angle))  # the map turns against its coordinates
    assert brightest(si) == pytest.approx([0.4 * c - 0.15 * s, 0.4 * s + 0.15 * c], abs=0.02)


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


def test_repeated_renders_compile_nothing_new(llvm: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Other maps, same kernels: compiling 40 fabrics costs as much as one."""
    for k in range(3):
        write_material(tmp_path / f"{k}.exr", fabric(seed=k))
    misses = []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for k in range(3):
            mi.render(mi.load_dict(scene({"type": "kinran", "filename": str(tmp_path / f"{k}.exr")})), spp=2, seed=k)
            dr.eval()
            history = [h for h in dr.kernel_history() if h["type"] == dr.KernelType.JIT]
            misses.append(sum(not h["cache_hit"] for h in history))
    assert misses[1:] == [0, 0]


def test_gradients_recover_a_map_from_renders(llvm: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
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


def test_samples_of_a_frozen_scene_move_with_its_parameters(
    llvm: str, fabric: Callable[..., Material], tmp_path: Path
) -> None:
    write_material(tmp_path / "a.exr", fabric())
    frame = mi.load_dict(scene({"type": "kinran", "filename": str(tmp_path / "a.exr")}))
    before = np.array(mi.render(frame, spp=4))
    p = mi.traverse(frame)
    p["cloth.bsdf.maps"] = p["cloth.bsdf.maps"] * 0.5
    p.update()
    assert np.array(mi.render(frame, spp=4)).mean() < before.mean()
