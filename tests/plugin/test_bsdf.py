"""The BSDF: what is fitted is what is rendered, in each variant."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from plugin_fabrics import centres, evaluate, in_variant, interaction, load

from kinran_bsdf import Material, bsdf, shared_maps, write_material
from kinran_bsdf.models.lambert import diffuse_lift
from kinran_bsdf.models.model import grazing
from kinran_bsdf.relight import clamp, relight

CASES = [("slope", 1, "gaussian"), ("slope", 1, "ggx"), ("slope", 2, "ggx"), ("takeda2008", 1, "gaussian")]
CASES += [("lambert", 0, "gaussian")]


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
    fitted = in_variant(relight(m, lights).reshape(-1, 3) / np.pi)
    np.testing.assert_allclose(seen, fitted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("model", "lobes", "tail"), CASES)
def test_variants_agree_with_numpy_at_any_view(
    variant_of_bands: str, fabric: Callable[..., Material], tmp_path: Path, model: str, lobes: int, tail: str
) -> None:
    """The same texel for random views and lights, against double precision; spectra are compared in test_colours.py."""
    m = fabric(model, lobes, tail)
    write_material(tmp_path / "a.exr", m)
    n = 40
    rng = np.random.default_rng(11)
    view, light = rng.normal(size=(2, n, 3))
    view[:, 2], light[:, 2] = np.abs(view[:, 2]) + 0.1, np.abs(light[:, 2]) + 0.1
    view /= np.linalg.norm(view, axis=1, keepdims=True)
    light /= np.linalg.norm(light, axis=1, keepdims=True)
    uv = np.tile(centres(m.size)[9], (n, 1))
    expected, floor = np.zeros((n, 3)), grazing(m.theta_max)
    for k, (colour, shape) in enumerate(m.terms()):
        values = [float(v) for v in shape.reshape(-1, shape.shape[-1])[9]]
        if k == 0:
            factor = diffuse_lift(view.T, light.T, *values, floor)
        else:
            factor = m.reflection.lobe(view.T, light.T, values, floor)
        expected += factor[:, None] * colour.reshape(-1, 3)[9]
    bsdf = load(tmp_path / "a.exr")
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
def test_bad_properties_are_refused(jit: str, properties: dict[str, Any], says: str) -> None:
    with pytest.raises((ValueError, RuntimeError), match=says):
        mi.load_dict({"type": "kinran", **properties})


def test_angles_are_never_interpolated(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", fabric("takeda2008"))
    with pytest.raises((ValueError, RuntimeError), match="would average angles"):
        load(tmp_path / "a.exr", filter="bilinear")
    with pytest.raises((ValueError, RuntimeError), match="wrap_mode 'mirror'"):
        load(tmp_path / "a.exr", wrap_mode="mirror")


def test_filtering_between_texels_keeps_the_energy(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """A checkerboard of bright narrow and faint wide lobes; filtered amplitudes would nearly treble its brightness."""
    m, n, rng = fabric(size=(16, 16)), 1 << 18, np.random.default_rng(0)
    y, x = np.mgrid[:16, :16]
    narrow = (x + y) % 2 == 0
    shape = {"x": 0, "y": 0, "xx": np.where(narrow, 0.01, 0.1), "xy": 0, "yy": np.where(narrow, 0.01, 0.1)}
    for name, value in {**shape, "amplitude": np.where(narrow, 2, 0.2)}.items():
        m.channels[f"lobe1.{name}"][:] = value
    m.channels["diffuse.amplitude"][:] = 0
    write_material(tmp_path / "a.exr", m)
    z, turn = rng.uniform([0, 0], [1, 2 * np.pi], (n, 2)).T
    r = np.sqrt(1 - z * z)
    light, uv = np.stack([r * np.cos(turn), r * np.sin(turn), z], -1), rng.random((n, 2))
    means = [
        evaluate(load(tmp_path / "a.exr", filter=name), uv, np.tile([0.0, 0, 1], (n, 1)), light).mean(0)
        for name in ("nearest", "bilinear")
    ]
    np.testing.assert_allclose(means[1], means[0], rtol=0.03)


def test_constants_equal_a_map_of_them(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
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


def test_textures_can_give_any_parameter(jit: str) -> None:
    checker = {"type": "checkerboard", "color0": 0.4, "color1": 0.1}
    bsdf = mi.load_dict({"type": "kinran", "lobe1_x": checker, "lobe1_xx": 0.01, "lobe1_yy": 0.01, "diffuse": 0.0})
    n = [[0.0, 0.0, 1.0]]
    for uv, slope in (((0.25, 0.25), 0.1), ((0.75, 0.25), 0.4)):
        light = np.array([[2 * slope, 0, 1 - slope**2]]) / (1 + slope**2)  # its half vector has this slope
        assert evaluate(bsdf, np.array([uv]), np.array(n), light)[0, 0] == pytest.approx(0.5, rel=1e-4)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_wrap_mode_and_to_uv(jit: str, fabric: Callable[..., Material], tmp_path: Path, wrap: str) -> None:
    """A fabric laid out 3 × 2 times: row 0 of the map is v = 0, and beyond 1 it repeats or stays."""
    m = fabric(size=(4, 4))
    write_material(tmp_path / "a.exr", m)
    transform = mi.ScalarTransform3f().scale([3, 2])
    bsdf = load(tmp_path / "a.exr", to_uv=transform, wrap_mode=wrap, filter="nearest")
    n = np.array([[0.0, 0.0, 1.0]])
    map_ = in_variant(relight(m, n)[0] / np.pi)
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


@pytest.mark.parametrize("model", ["slope", "takeda2008"])
def test_white_furnace_with_the_clamp(jit: str, fabric: Callable[..., Material], tmp_path: Path, model: str) -> None:
    """Far too bright lobes: with `bound` no texel gives back more than the sky gave it, seen from N."""
    m = fabric(model, size=(4, 4))
    m.channels["lobe1.amplitude"][:] *= 8
    m.channels["bound"][:] = clamp(m)
    assert m.channels["bound"].min() < 0.5
    write_material(tmp_path / "a.exr", m)
    bsdf = load(tmp_path / "a.exr", filter="nearest")
    n, rng = 1 << 14, np.random.default_rng(1)
    uv = np.repeat(centres(m.size), n, 0)
    si = interaction(uv, np.tile([0.0, 0.0, 1.0], (len(uv), 1)))
    u = rng.random((3, len(uv))).astype(np.float32)
    weight = np.array(bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))[1])
    albedo = weight.reshape(3, -1, n).mean(-1)
    assert 0.95 < albedo.max() < 1.02


def test_scenes_share_maps_that_are_read_once_where_asked(
    fabric: Callable[..., Material], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mi.set_variant("llvm_ad_rgb")
    write_material(tmp_path / "a.exr", fabric("slope", 1, "gaussian"))
    write_material(tmp_path / "b.exr", fabric("slope", 2, "gaussian"))
    reads: list[str] = []
    read = bsdf.read_material
    monkeypatch.setattr(bsdf, "read_material", lambda path: reads.append(Path(path).name) or read(path))
    with shared_maps():
        first, nearest, same, other = (
            load(tmp_path / name, **more)
            for name, more in (("a.exr", {}), ("a.exr", {"filter": "nearest"}), ("a.exr", {}), ("b.exr", {}))
        )
        with shared_maps():
            assert load(tmp_path / "a.exr").maps is first.maps
        assert same.maps is first.maps
        assert nearest.maps is not first.maps
        assert other.maps is not first.maps
        assert reads == ["a.exr", "a.exr", "b.exr"]
    assert load(tmp_path / "a.exr").maps is not first.maps
