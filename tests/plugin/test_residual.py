"""The residual: its spline, its file, and that the renderer shows at the measured view what relighting shows."""

from dataclasses import replace
from pathlib import Path

import mitsuba as mi
import numpy as np
import pytest
from conftest import choose
from plugin_fabrics import centres, evaluate, in_variant, interaction, load, random_material

from kinran_bsdf import Material, colours, read_material, write_material
from kinran_bsdf.relight import relight
from kinran_bsdf.residual import Residual, compress, expand, kernel_matrix, spline


def dome(n: int, seed: int) -> np.ndarray:
    """Directions (n, 3) up to 60° from the normal."""
    z, turn = np.random.default_rng(seed).uniform([0.5, 0], [1, 2 * np.pi], (n, 2)).T
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)


@pytest.fixture
def material() -> Material:
    """A slope material with a residual of three components, as strong as a shadow."""
    plain = random_material("slope", 1, "ggx")
    rng = np.random.default_rng(3)
    maps = {f"residual{k}.{c}": rng.normal(0, 0.05, plain.size).astype(np.float32) for k in range(4) for c in "RGB"}
    lights = dome(30, 1)
    weights = spline(lights, np.linalg.qr(rng.normal(size=(30, 3)))[0], 1e-2)
    residual = Residual("srgb", 0.8, lights[:, :2], weights)
    return replace(plain, channels={**plain.channels, **maps}, residual=residual)


def test_spline_goes_through_its_values_and_reproduces_planes() -> None:
    at = dome(25, 0)
    values = np.random.default_rng(1).normal(size=(25, 2))
    exact = kernel_matrix(at[:, :2], at[:, :2]) @ spline(at, values, 0.0)
    np.testing.assert_allclose(exact, values, atol=1e-8)
    plane = (1 + 2 * at[:, 0] - 3 * at[:, 1])[:, None]
    elsewhere = dome(50, 2)[:, :2]
    found = kernel_matrix(elsewhere, at[:, :2]) @ spline(at, plane, 10.0)
    np.testing.assert_allclose(found[:, 0], 1 + 2 * elsewhere[:, 0] - 3 * elsewhere[:, 1], atol=1e-7)


def test_spline_of_three_lights_on_a_line_stays_finite() -> None:
    assert np.isfinite(spline(np.array([[0, 0], [0.1, 0], [0.2, 0.0]]), np.ones((3, 1)), 1e-2)).all()


@pytest.mark.parametrize("domain", ["srgb", "linear", "gamma:2.2", "log:3.5"])
def test_expand_inverts_compress_also_above_white(domain: str) -> None:
    light = np.geomspace(1e-4, 20, 100)
    np.testing.assert_allclose(expand(compress(light, domain), domain), light, rtol=1e-6)
    assert compress(-1.0, domain) == 0
    assert expand(-1.0, domain) == 0


def test_file_round_trip(tmp_path: Path, material: Material) -> None:
    write_material(tmp_path / "m.exr", material)
    back = read_material(tmp_path / "m.exr")
    lights = dome(9, 5)
    np.testing.assert_allclose(relight(back, lights), relight(material, lights), atol=2e-3)  # half precision
    write_material(tmp_path / "again.exr", back)
    again = read_material(tmp_path / "again.exr")
    assert all(np.array_equal(again.channels[name], plane) for name, plane in back.channels.items())
    assert np.abs(relight(material, lights) - relight(replace(material, residual=None), lights)).max() > 0.05


def test_a_missing_map_is_named(tmp_path: Path, material: Material) -> None:
    channels = {name: plane for name, plane in material.channels.items() if name != "residual2.G"}
    with pytest.raises(ValueError, match=r"residual2\.G"):
        write_material(tmp_path / "m.exr", replace(material, channels=channels))


def test_render_is_relight_at_the_measured_view(tmp_path: Path, material: Material, jit: str) -> None:
    """Up to the table of the spline: 128 steps for what relighting evaluates exactly."""
    write_material(tmp_path / "m.exr", material)
    bsdf, uv = load(tmp_path / "m.exr", filter="nearest"), centres(material.size)
    view = np.tile([0.0, 0, 1], (len(uv), 1))
    for light in dome(6, 8):
        T = evaluate(bsdf, uv, view, np.tile(light, (len(uv), 1)))
        expected = in_variant(relight(material, light[None])[0].reshape(-1, 3) / np.pi)
        np.testing.assert_allclose(T, np.maximum(expected, 0), atol=2e-3)


def test_it_fades_where_nothing_was_measured_and_is_never_negative(
    tmp_path: Path, material: Material, jit: str
) -> None:
    write_material(tmp_path / "m.exr", material)
    write_material(tmp_path / "plain.exr", replace(material, residual=None))
    uv = np.tile(centres(material.size), (20, 1))
    whole, plain = (load(tmp_path / name, filter="nearest") for name in ("m.exr", "plain.exr"))
    changes = []
    for degrees in (0, 30, 60):
        view = np.tile([np.sin(np.radians(degrees)), 0, np.cos(np.radians(degrees))], (len(uv), 1))
        light = dome(len(uv), 4)
        with_it, without = (evaluate(bsdf, uv, view, light) for bsdf in (whole, plain))
        assert with_it.min() >= 0
        changes.append(np.abs(with_it - without).mean())
    assert changes[0] > 2 * changes[1] > 0
    assert changes[2] < 0.15 * changes[0]  # what is left comes from lights near N, where reciprocity speaks


def test_what_only_the_residual_shows_is_sampled(tmp_path: Path, material: Material, jit: str) -> None:
    """Where lobes and diffuse term are black: the albedo by sampling is that by uniform directions."""
    for name in ("diffuse", "lobe1"):
        material.channels[f"{name}.amplitude"][:] = 0
    for c in "RGB":
        material.channels[f"residual0.{c}"][:] = 0.5
    write_material(tmp_path / "m.exr", material)
    bsdf, n, rng = load(tmp_path / "m.exr", filter="nearest"), 1 << 18, np.random.default_rng(2)
    si = interaction(rng.random((n, 2)), np.tile([0.0, 0, 1], (n, 1)))
    u = rng.random((5, n)).astype(np.float32)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:3]))
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(u[3:]))
    uniform = np.array(bsdf.eval(mi.BSDFContext(), si, wo)).mean(1) * 2 * np.pi
    assert uniform.min() > 0.1
    np.testing.assert_allclose(np.array(weight).mean(1), uniform, rtol=0.02)


@pytest.mark.parametrize("with_it", [True, False])
def test_other_variants_show_the_colours_of_rgb(tmp_path: Path, material: Material, with_it: bool) -> None:
    """Mono its luminance and spectra its primaries, at views where the residual is whole, fades, and clamps to 0."""
    if with_it:
        material.channels["residual0.R"][:] -= 0.3  # leaves red of the stack's at 0, and less than 0 in Rec.709
    write_material(tmp_path / "m.exr", material if with_it else replace(material, residual=None))
    uv = np.tile(centres(material.size), (6, 1))
    view, light = dome(len(uv), 2), dome(len(uv), 4)
    view[: len(uv) // 2] = 0, 0, 1

    def seen(variant: str) -> np.ndarray:
        choose(variant)
        bsdf, si = load(tmp_path / "m.exr", filter="nearest"), interaction(uv, view)
        if mi.is_spectral:
            si.wavelengths = [450.0, 550, 600, 700]
        return np.array(bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(light.T.astype(np.float32)))).T

    rgb = seen("llvm_ad_rgb")
    assert (rgb > 0).any(1).all()
    assert (rgb == 0).any() == with_it
    np.testing.assert_allclose(seen("llvm_ad_mono")[:, 0], rgb @ colours.LUMINANCE, rtol=1e-5)
    spectra = seen("llvm_ad_spectral")
    primaries = np.array(colours.Primaries().at([mi.Float(w) for w in (450, 550, 600, 700)], True))[..., 0]
    np.testing.assert_allclose(spectra, rgb @ primaries.T, rtol=2e-5)
