"""Colours: the same fabric looks alike in RGB, spectral and mono variants."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from conftest import choose

from kinran_bsdf import Material, colours, write_material


def flat(fabric: Callable[..., Material], rec709: list[float], amplitude: float = 1 / np.pi) -> Material:
    """Lambertian fabric of one colour."""
    m = fabric("lambert", 0, size=(1, 1))
    acescg = np.linalg.solve(colours.TO_REC709, rec709)
    values = {f"diffuse.{c}": np.full((1, 1), v, np.float32) for c, v in zip("RGB", acescg, strict=True)}
    values |= {"diffuse.amplitude": np.full((1, 1), amplitude, np.float32)}
    values |= {f"diffuse.{s}": np.zeros((1, 1), np.float32) for s in "xy"}
    return replace(m, channels=m.channels | values)


def furnace(path: Path) -> np.ndarray:
    """Picture of the fabric under a white sky, in RGB (or one band in mono)."""
    scene = {
        "type": "scene",
        "integrator": {"type": "direct"},
        "sensor": {
            "type": "perspective",
            "to_world": mi.ScalarTransform4f().look_at(origin=[0, 0, 1], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
        },
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}},
        "cloth": {"type": "rectangle", "bsdf": {"type": "kinran", "filename": str(path)}},
    }
    return np.array(mi.render(mi.load_dict(scene), spp=1024)).mean((0, 1))


@pytest.mark.parametrize("rec709", [[1, 1, 1], [0.7, 0.1, 0.05], [0.05, 0.3, 0.9], [0.9, 0.6, 0.1]])
def test_a_colour_comes_back_from_a_render(
    fabric: Callable[..., Material], tmp_path: Path, rec709: list[float], variant_jit: str
) -> None:
    write_material(tmp_path / "a.exr", flat(fabric, rec709))
    seen = furnace(tmp_path / "a.exr")
    expected = [float(np.dot(rec709, colours.LUMINANCE))] if "mono" in variant_jit else rec709
    # spectral: Monte Carlo over wavelengths; Mitsuba's own white deviates by 0.5 %
    np.testing.assert_allclose(seen, expected, atol=0.015 if "spectral" in variant_jit else 0.002)


def test_primaries_add_up_and_give_back_rec709() -> None:
    """Under D65, integrated at 1 nm with the colour-matching functions that Mitsuba has."""
    choose("llvm_ad_spectral")
    wavelengths = np.arange(360, 831, dtype=np.float32)
    si = dr.zeros(mi.SurfaceInteraction3f, len(wavelengths))
    si.wavelengths = type(si.wavelengths)(*[mi.Float(wavelengths)] * 4)
    d65 = np.array(mi.load_dict({"type": "d65"}).eval(si))[0]
    xyz = np.array(mi.cie1931_xyz(mi.Float(wavelengths))) * d65
    to_rgb = np.array(
        [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
    )
    primaries = np.array(colours.Primaries().at([mi.Float(wavelengths)], True)[0])
    assert primaries.min() >= 0
    np.testing.assert_allclose(primaries.sum(0), 1, atol=1e-5)
    back = to_rgb @ xyz @ primaries.T / xyz[1].sum()
    np.testing.assert_allclose(back, np.eye(3), atol=2e-3)


def test_values_above_one_do_not_saturate(fabric: Callable[..., Material], tmp_path: Path) -> None:
    """Gold of 54, 40, 19 at a lobe's peak keeps its hue in spectral variants (built-in textures go white)."""
    choose("llvm_ad_spectral")
    write_material(tmp_path / "a.exr", flat(fabric, [1.0, 40 / 54, 19 / 54], 54 / np.pi))
    np.testing.assert_allclose(furnace(tmp_path / "a.exr") / 54, [1, 40 / 54, 19 / 54], atol=0.015)


def test_colours_outside_rec709_are_clamped_at_zero(fabric: Callable[..., Material]) -> None:
    choose("llvm_ad_rgb")
    green = np.array([[0.0, 1.0, 0.0]])  # of ACEScg
    assert (green @ colours.TO_REC709.T).min() < 0
    assert colours.pack(green, 3).min() == 0
