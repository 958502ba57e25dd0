"""Minification: a far fabric has the energy of its texels, and a lobe as wide as all their slopes."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import choose

from kinran_bsdf import Material, pyramid, write_material
from kinran_bsdf.maps import PackedMaps, pack
from kinran_bsdf.mixture import mean
from kinran_bsdf.models import Slope
from kinran_bsdf.pyramid import Pyramid, halve
from kinran_bsdf.residual import Residual, spline


def weave(fabric: Callable[..., Material], size: tuple[int, int] = (64, 64)) -> Material:
    """Ribs of narrow lobes: slopes run like the threads of a twill, with some noise, on a diffuse ground."""
    m = fabric(size=size)
    y, x = np.mgrid[: size[0], : size[1]]
    m.channels["lobe1.x"][:] = 0.25 * np.sin(2 * np.pi * (x + y) / 8) + 0.1 * m.channels["lobe1.x"]
    m.channels["lobe1.y"][:] = 0.1 * m.channels["lobe1.y"]
    m.channels["lobe1.xx"][:], m.channels["lobe1.yy"][:], m.channels["lobe1.xy"][:] = 0.01, 0.03, 0
    m.channels["lobe1.amplitude"][:] = 0.8
    return m


def rough(fabric: Callable[..., Material]) -> Material:
    """The same, with slopes that are normally distributed from texel to texel."""
    m = weave(fabric)
    x, y = np.random.default_rng(4).normal(scale=[[[0.2]], [[0.1]]], size=(2, 64, 64))
    m.channels["lobe1.x"][:], m.channels["lobe1.y"][:] = x, y
    return m


def patterned(fabric: Callable[..., Material]) -> Material:
    """Flat cloth whose residual changes from texel to texel, by a third of what is seen on the average."""
    m, rng, size = fabric(size=(64, 64), tail="ggx"), np.random.default_rng(3), (64, 64)
    shape = {"diffuse.x": 0, "diffuse.y": 0, "lobe1.x": 0.1, "lobe1.y": 0, "lobe1.xx": 0.03, "lobe1.yy": 0.05}
    for name, value in {**shape, "lobe1.xy": 0}.items():
        m.channels[name][:] = value
    y, x = np.mgrid[:64, :64]
    stripes = 0.15 * np.sin(2 * np.pi * (x + 0.6 * y) / 2.7)
    maps = rng.normal(scale=0.3, size=(4, 3, *size))
    maps[0] = stripes + 0.02 * rng.normal(size=(3, *size))
    m.channels.update(
        {f"residual{k}.{c}": maps[k, i].astype(np.float32) for k in range(4) for i, c in enumerate("RGB")}
    )
    z, turn = rng.uniform([0.5, 0], [1, 2 * np.pi], (30, 2)).T
    lights = np.sqrt(1 - z * z)[:, None] * np.stack([np.cos(turn), np.sin(turn)], -1)
    weights = spline(lights, np.linalg.qr(rng.normal(size=(30, 3)))[0], 1e-2)
    return replace(m, residual=Residual("srgb", 0.8, lights, weights))


def apex(m: Material, levels: int) -> np.ndarray:
    packed, weights = pack(m, 3), None
    for _ in range(levels):
        packed, weights = halve(packed, weights, 3, m.reflection)
    return packed


@pytest.mark.parametrize("lobes", [1, 2])
@pytest.mark.parametrize("size", [(64, 64), (48, 80), (37, 53)])
def test_levels_keep_the_energy_of_each_band(
    jit: str, fabric: Callable[..., Material], size: tuple[int, int], lobes: int
) -> None:
    m = fabric(lobes=lobes, size=size)
    top, texels = apex(m, 6), pack(m, 3)
    assert top.shape[:2] == (1, 1)
    np.testing.assert_allclose(top[0, 0, :3], texels[..., :3].mean((0, 1)), rtol=1e-5)
    energy = [sum(packed[..., 5 + 8 * k : 8 + 8 * k] for k in range(lobes)) for packed in (top, texels)]
    np.testing.assert_allclose(energy[0][0, 0], energy[1].mean((0, 1)), rtol=1e-5)


@pytest.mark.parametrize(("tail", "part"), [("gaussian", 2), ("ggx", 4)])
def test_a_lobe_has_the_mean_and_the_variance_of_four(
    jit: str, fabric: Callable[..., Material], tail: str, part: int
) -> None:
    """By energy times the root of amplitude; part is what a variance is in squared widths, at the centre of a lobe."""
    m = fabric(size=(2, 2), tail=tail)
    texels, top = pack(m, 3).reshape(4, 13).astype(float), apex(m, 1)[0, 0]
    energy = texels[:, 5:8].sum(1)
    weight = energy * np.sqrt(energy / m.reflection.albedo(texels[:, 8:].T))
    spread = np.cov(texels[:, 8:10].T, aweights=weight, ddof=0) * part
    own = np.average(texels[:, 10:], 0, weights=weight)
    np.testing.assert_allclose(top[8:10], np.average(texels[:, 8:10], 0, weights=weight), atol=1e-5)
    np.testing.assert_allclose(top[10:], own + spread[[0, 0, 1], [0, 1, 1]], atol=1e-5)


@pytest.mark.parametrize("lobes", [1, 2])
def test_narrowest_lobes_at_steep_slopes_stay_lobes(jit: str, fabric: Callable[..., Material], lobes: int) -> None:
    m = fabric(size=(16, 16), lobes=lobes)
    for k in range(1, lobes + 1):
        for name, value in {"x": 3.0, "y": -3.0, "xx": 1e-6, "xy": 0, "yy": 1e-6}.items():
            m.channels[f"lobe{k}.{name}"][:] = value
    top = apex(m, 4)
    assert np.isfinite(top).all()
    assert (top[..., 10] * top[..., 12] > top[..., 11] ** 2).all()


def crossed(fabric: Callable[..., Material]) -> Material:
    """Ribs with a lobe on each flank, whose order changes from texel to texel."""
    m, rng, size = fabric(lobes=2, size=(64, 64)), np.random.default_rng(0), (64, 64)
    side = np.where(rng.random(size) < 0.5, 1, -1) * rng.normal(0.25, 0.05, size)
    for k, sign in ((1, 1), (2, -1)):
        shape = {"x": sign * side, "y": rng.normal(scale=0.1, size=size), "xx": 0.01, "xy": 0, "yy": 0.03}
        for name, value in {**shape, "amplitude": 0.5}.items():
            m.channels[f"lobe{k}.{name}"][:] = value
    return m


def nested(fabric: Callable[..., Material]) -> Material:
    """Yarns with a bright narrow lobe in a faint wide one, always in this order."""
    m, rng, size = fabric(lobes=2, size=(64, 64)), np.random.default_rng(0), (64, 64)
    x, y = rng.normal(scale=[[[0.2]], [[0.05]]], size=(2, *size))
    for k, (width, amplitude) in enumerate(((0.005, 2.0), (0.1, 0.2)), 1):
        shape = {"x": x, "y": y, "xx": width, "xy": 0, "yy": 2 * width, "amplitude": amplitude * rng.random(size)}
        for name, value in shape.items():
            m.channels[f"lobe{k}.{name}"][:] = value
    return m


def even(fabric: Callable[..., Material]) -> Material:
    """Cloth of a narrow and a wide lobe that is the same everywhere but for noise in its slopes."""
    m, rng = nested(fabric), np.random.default_rng(0)
    for k, (mean_slope, amplitude) in enumerate(((0.1, 2.0), (0.0, 1.0)), 1):
        for s in "xy":
            m.channels[f"lobe{k}.{s}"][:] = rng.normal(mean_slope, 0.03, (64, 64))
        m.channels[f"lobe{k}.amplitude"][:] = amplitude
    return m


@pytest.mark.parametrize(("make", "bound"), [(crossed, 0.08), (nested, 0.2), (even, 0.03)])
def test_lobes_are_grouped_as_they_belong_together(
    jit: str, fabric: Callable[..., Material], make: Any, bound: float
) -> None:
    """Levels 1 to 3 against the mean of their texels at V = N: relative RMS over lights."""
    m = make(fabric)
    packed = pack(m, 3)
    maps = PackedMaps(m, "nearest", "repeat", 0.1, False)
    z, turn = np.random.default_rng(1).uniform([0.4, 0], [1, 2 * np.pi], (30, 2)).T
    r = np.sqrt(1 - z * z)

    def seen(level: np.ndarray) -> np.ndarray:
        channels = list(np.moveaxis(level, -1, 0))
        lights = np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)
        return np.array([maps.radiance(channels, light) for light in lights])

    truth, weights = seen(packed), None
    for _ in range(3):
        packed, weights = halve(packed, weights, 3, Slope(lobes=2))
        truth = mean(truth)
        assert np.sqrt(np.mean((seen(packed) - truth) ** 2) / np.mean(truth**2)) < bound


def test_blocks_of_rows_are_one_whole(jit: str, fabric: Callable[..., Material], monkeypatch: Any) -> None:
    packed = pack(fabric(lobes=2, size=(24, 10)), 3)
    whole = halve(packed, None, 3, Slope(lobes=2))
    monkeypatch.setattr(pyramid, "BLOCK", 40)
    for found, expected in zip(halve(packed, None, 3, Slope(lobes=2)), whole, strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-6)


def test_fabric_without_lobes_has_a_pyramid(jit: str, fabric: Callable[..., Material]) -> None:
    m = fabric(size=(8, 8))
    m.channels["lobe1.amplitude"][:] = 0
    top = apex(m, 3)
    assert np.isfinite(top).all()
    np.testing.assert_allclose(top[0, 0, 5:8], 0)


@pytest.mark.parametrize("wrap", ["repeat", "clamp"])
def test_each_level_is_found_and_wraps(jit: str, fabric: Callable[..., Material], wrap: str) -> None:
    packed = pack(weave(fabric, (24, 40)), 3)
    levels = Pyramid(packed, lambda m, w: halve(m, w, 3, Slope()), wrap)
    level, weights = packed, None
    for k in range(1, levels.count + 1):
        level, weights = halve(level, weights, 3, Slope())
        height, width = level.shape[:2]
        for y, x in ((0, 0), (height - 1, width - 1), (height // 2, width // 3)):
            uv = mi.Point2f((x + 0.5) / width, (y + 0.5) / height)
            np.testing.assert_allclose(np.ravel(levels.fetch(uv, mi.Float(k), True)), level[y, x], atol=2e-4)
        seam = np.ravel(levels.fetch(mi.Point2f(1, 0.5 / height), mi.Float(k), True))
        other = level[0, 0] if wrap == "repeat" else level[0, -1]
        np.testing.assert_allclose(seam, (level[0, -1] + other) / 2, atol=2e-4)


def far_view(path: Path, light: list[float], repeat: int, angle: float, spp: int) -> Any:
    bsdf: dict[str, Any] = {"type": "kinran", "filename": str(path), "pixel_angle": angle}
    bsdf["filter"] = "nearest"  # bilinear interpolation would itself smooth slopes
    bsdf["to_uv"] = mi.ScalarTransform4f().scale([repeat, repeat, 1])
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "perspective",
            "fov": 10,
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}},
        },
        "light": {"type": "directional", "direction": light, "irradiance": 1.0},
        "cloth": {"type": "rectangle", "bsdf": bsdf},
    }
    return np.array(mi.render(mi.load_dict(scene), spp=spp, seed=3))


PIXEL = np.radians(10) / 16


@pytest.mark.parametrize("light", [[0, 0, -1], [-0.5, 0, -0.9], [0.3, 0.4, -0.9]])
@pytest.mark.parametrize(("make", "bound"), [(rough, 0.05), (weave, 0.25), (patterned, 0.04), (crossed, 0.05)])
def test_far_view_is_the_supersampled_one(
    jit: str, fabric: Callable[..., Material], tmp_path: Path, light: list[float], make: Any, bound: float
) -> None:
    """A pixel covers 14 × 14 texels or more: one sample of the pyramid against 1024 of the map.

    Normally distributed slopes give one wide lobe again. The ribs of a twill do not: two peaks become one,
    and its value under a single light is right to a quarter only, though its energy is right (below). A residual whose
    maps were just averaged would be 4 to 8 % too dark, as display-like values are not linear in light.
    """
    write_material(tmp_path / "a.exr", make(fabric))
    reference = far_view(tmp_path / "a.exr", light, 4, 0.0, 1024)
    aliased = far_view(tmp_path / "a.exr", light, 4, 0.0, 1)
    filtered = far_view(tmp_path / "a.exr", light, 4, PIXEL, 1)

    def error(image: np.ndarray) -> float:
        return float(np.sqrt(np.mean((image - reference) ** 2)) / reference.mean())

    assert filtered.mean() == pytest.approx(reference.mean(), rel=bound)
    assert error(filtered) < bound + 0.05
    assert error(aliased) > 2 * error(filtered)


def test_far_view_keeps_the_mean_energy(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Under a white sky the pyramid reflects what the map reflects."""
    write_material(tmp_path / "a.exr", weave(fabric))
    means = []
    for angle in (0.0, PIXEL):
        bsdf = mi.load_dict({"type": "kinran", "filename": str(tmp_path / "a.exr"), "pixel_angle": angle})
        n, rng = 1 << 18, np.random.default_rng(1)
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t, si.dp_du, si.dp_dv = mi.Float(1000.0), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.uv = mi.Point2f(rng.random((2, n)).astype(np.float32))
        si.wi, si.sh_frame = mi.Vector3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
        u = rng.random((3, n)).astype(np.float32)
        weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:]))[1]
        means.append(np.array(weight).mean(1))
    np.testing.assert_allclose(means[1], means[0], rtol=0.01)


def test_far_residual_keeps_the_mean_over_measured_lights(
    jit: str, fabric: Callable[..., Material], tmp_path: Path
) -> None:
    write_material(tmp_path / "a.exr", patterned(fabric))
    n, rng, means = 1 << 18, np.random.default_rng(1), []
    z, turn = rng.uniform([0.5, 0], [1, 2 * np.pi], (n, 2)).T
    r = np.sqrt(1 - z * z)
    light = mi.Vector3f(np.stack([r * np.cos(turn), r * np.sin(turn), z]).astype(np.float32))
    for angle in (0.0, PIXEL):
        bsdf = {"type": "kinran", "filename": str(tmp_path / "a.exr"), "pixel_angle": angle, "filter": "nearest"}
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t, si.dp_du, si.dp_dv = mi.Float(1000.0), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.uv = mi.Point2f(rng.random((2, n)).astype(np.float32))
        si.wi, si.sh_frame = mi.Vector3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
        means.append(np.array(mi.load_dict(bsdf).eval(mi.BSDFContext(), si, light)).mean(1))
    np.testing.assert_allclose(means[1], means[0], rtol=0.02)


def test_near_view_uses_the_map_itself(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", weave(fabric))
    there = far_view(tmp_path / "a.exr", [0, 0, -1], 4, 0.0, 1)
    np.testing.assert_allclose(far_view(tmp_path / "a.exr", [0, 0, -1], 4, 1e-6, 1), there, rtol=1e-5)


def test_scalar_variants_have_a_pyramid(fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Their masks are Python's bools, which `~` does not invert; a near point sees the map, far ones the top level."""
    choose("scalar_rgb")
    write_material(tmp_path / "a.exr", weave(fabric))

    def seen(angle: float, distance: float, u: float) -> np.ndarray:
        bsdf = mi.load_dict({"type": "kinran", "filename": str(tmp_path / "a.exr"), "pixel_angle": angle})
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.t, si.uv, si.dp_du, si.dp_dv = distance, mi.Point2f(u, 0.5), mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
        si.wi, si.sh_frame = mi.Vector3f(0, 0, 1), mi.Frame3f(mi.Normal3f(0, 0, 1))
        return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(0, 0, 1)))

    np.testing.assert_allclose(seen(PIXEL, 1e-3, 0.3), seen(0.0, 1e-3, 0.3), rtol=1e-6)
    np.testing.assert_allclose(seen(PIXEL, 1e3, 0.3), seen(PIXEL, 1e3, 0.6), rtol=1e-5)


def test_only_changed_maps_are_filtered_again(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    """And maps of another size are taken, but not of other channels."""
    write_material(tmp_path / "a.exr", weave(fabric))
    bsdf = mi.load_dict({"type": "kinran", "filename": str(tmp_path / "a.exr"), "pixel_angle": 0.01, "back": 0.5})
    parameters, levels = mi.traverse(bsdf), bsdf.maps.pyramid
    parameters["back.value"] = 0.25
    parameters.update()
    assert bsdf.maps.pyramid is levels
    texels = bsdf.per_texel
    parameters["maps"] = mi.TensorXf(np.array(parameters["maps"])[:32])
    parameters.update()
    assert bsdf.maps.pyramid is not levels
    np.testing.assert_allclose(np.array(bsdf.per_texel) * 2, np.array(texels))
    parameters["maps"] = mi.TensorXf(np.array(parameters["maps"])[..., 1:])
    with pytest.raises((ValueError, RuntimeError), match="13 channels, not 12"):
        parameters.update()


def test_angles_and_textures_have_no_pyramid(jit: str, fabric: Callable[..., Material], tmp_path: Path) -> None:
    write_material(tmp_path / "a.exr", fabric("takeda2008"))
    with pytest.raises((ValueError, RuntimeError), match="would average angles"):
        mi.load_dict({"type": "kinran", "filename": str(tmp_path / "a.exr"), "pixel_angle": 0.01})
    with pytest.raises((ValueError, RuntimeError), match="needs a material file"):
        mi.load_dict({"type": "kinran", "pixel_angle": 0.01})
