"""The models as formulas, in NumPy: what Eq. 3 says, where it fails, and what the slope lobe does."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from kinran_bsdf import Material
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.models import Slope, Takeda2008
from kinran_bsdf.models.lambert import diffuse, diffuse_lift
from kinran_bsdf.models.model import GRAZING
from kinran_bsdf.models.slope import lobe_lift
from kinran_bsdf.relight import albedo, clamp, relight

N = (0.0, 0.0, 1.0)


def sphere(n: int, seed: int = 0) -> np.ndarray:
    """Uniform directions of the upper hemisphere as (3, n)."""
    z, turn = np.random.default_rng(seed).random((2, n))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(2 * np.pi * turn), r * np.sin(2 * np.pi * turn), z])


def test_takeda2008_is_equation_3(fabric: Callable[..., Material], lights: np.ndarray) -> None:
    """Written out anew, with no wrapping needed: each azimuth is taken at its nearest turn."""
    m = fabric("takeda2008")
    c = {name: value.astype(np.float64) for name, value in m.channels.items()}
    images = relight(m, lights)
    for light, image in zip(lights, images, strict=True):
        h = light + np.array(N)
        theta_h, phi_h = np.arccos(h[2] / np.linalg.norm(h)), np.arctan2(h[1], h[0])
        turns = [((phi_h + 2 * np.pi * k - c["lobe1.phi"]) / c["lobe1.dp"]) ** 2 for k in (-1, 0, 1)]
        g = np.exp(-(((theta_h - c["lobe1.theta"]) / c["lobe1.dt"]) ** 2) - np.min(turns, 0))
        d = np.maximum(light[2] + c["diffuse.x"] * light[0] + c["diffuse.y"] * light[1], 0)
        for k, band in enumerate("RGB"):
            t = c["lobe1.amplitude"] * c[f"lobe1.{band}"] * g + c["diffuse.amplitude"] * c[f"diffuse.{band}"] * d
            np.testing.assert_allclose(image[..., k], np.pi * t, atol=3e-6)


@pytest.mark.parametrize("tail", ["gaussian", "ggx"])
def test_slope_is_its_formula(fabric: Callable[..., Material], lights: np.ndarray, tail: str) -> None:
    m = fabric("slope", 2, tail)
    c = {name: value.astype(np.float64) for name, value in m.channels.items()}
    for light, image in zip(lights, relight(m, lights), strict=True):
        d = np.maximum(light[2] + c["diffuse.x"] * light[0] + c["diffuse.y"] * light[1], 0)
        t = c["diffuse.amplitude"] * c["diffuse.G"] * d
        for k in ("lobe1", "lobe2"):
            s = np.stack([c[f"{k}.xx"], c[f"{k}.xy"], c[f"{k}.xy"], c[f"{k}.yy"]], -1).reshape(*m.size, 2, 2)
            e = light[:2] / (1 + light[2]) - np.stack([c[f"{k}.x"], c[f"{k}.y"]], -1)
            q = np.einsum("yxi,yxij,yxj->yx", e, np.linalg.inv(s), e)
            t += c[f"{k}.amplitude"] * c[f"{k}.G"] * (np.exp(-q) if tail == "gaussian" else (1 + q) ** -2.0)
        np.testing.assert_allclose(image[..., 1], np.pi * t, atol=3e-6)


def test_relight_goes_back_to_the_colours_of_the_stack(fabric: Callable[..., Material]) -> None:
    m = fabric()
    matrix = np.array([[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.0, 0.2, 0.8]])
    there = relight(replace(m, from_stack=matrix), np.array([N]))
    np.testing.assert_allclose(there @ matrix.T, relight(m, np.array([N])), rtol=1e-5)


def test_relight_in_blocks_is_relight(fabric: Callable[..., Material], lights: np.ndarray) -> None:
    """A fabric of several blocks equals its halves."""
    m = fabric(size=(300, 512))
    whole = relight(m, lights[:3])
    half = replace(m, channels={k: v[150:] for k, v in m.channels.items()})
    np.testing.assert_array_equal(whole[:, 150:], relight(half, lights[:3]))


def test_light_under_the_horizon_gives_nothing(fabric: Callable[..., Material]) -> None:
    assert relight(fabric(), [[0.6, 0, -0.8]]).max() == 0


@pytest.mark.parametrize("degrees", [350, 181, 145])
def test_lobe_is_seen_across_the_wrap(degrees: float) -> None:
    """Unwrapped, with φ_n in [0, 2π) and arctan2 in (−π, π], a lobe at 350° loses all, at 181° half."""
    phi, narrow = np.radians(degrees), 0.3
    turn = np.linspace(-np.pi, np.pi, 4001)
    wrapped = Takeda2008.of_angles(0.5, turn, 0.5, phi, 0.2, narrow)
    unwrapped = np.exp(-(((turn - phi) / narrow) ** 2))
    full = narrow * np.sqrt(np.pi)
    assert np.trapezoid(wrapped, turn) == pytest.approx(full, rel=1e-3)
    kept = {350: 0.0, 181: 0.47, 145: 0.99}[degrees]
    assert np.trapezoid(unwrapped, turn) / full == pytest.approx(kept, abs=0.02)


def test_equation_3_jumps_at_the_pole_and_slope_does_not() -> None:
    """Half vectors a hair from N on all sides: Eq. 3 gives anything from 0 to 78 % of its peak."""
    turn = np.linspace(-np.pi, np.pi, 361)
    takeda = Takeda2008.of_angles(1e-6, turn, 0.1, 0.0, 0.2, 0.5)
    assert takeda.max() == pytest.approx(0.78, abs=0.01)
    assert takeda.min() < 1e-6
    slope = Slope().of_slopes(1e-6 * np.cos(turn), 1e-6 * np.sin(turn), 0.1, 0.0, 0.04, 0.0, 0.01)
    assert np.ptp(slope) < 1e-5


@pytest.mark.parametrize("tail", ["gaussian", "ggx"])
@pytest.mark.parametrize("shape", [(0.0, 0.0, 0.04, 0.0, 0.04), (0.5, -0.3, 0.3, 0.1, 0.06), (0.9, 0, 1, 0, 1)])
def test_slope_and_diffuse_are_reciprocal(tail: str, shape: tuple[float, ...]) -> None:
    v, l = sphere(20_000, 1), sphere(20_000, 2)  # noqa: E741
    floor = GRAZING
    there = Slope(tail).lobe(v, l, shape, floor) / l[2]
    back = Slope(tail).lobe(l, v, shape, floor) / v[2]
    np.testing.assert_allclose(there, back, rtol=1e-9, atol=1e-300)
    there = diffuse_lift(v, l, 0.4, -0.3, floor) / l[2]
    np.testing.assert_allclose(there, diffuse_lift(l, v, 0.4, -0.3, floor) / v[2], rtol=1e-9)


def test_equation_3_is_not_reciprocal() -> None:
    """Mean asymmetry of f relative to its mean: 0.45 or so, where the slope lobe has none."""
    v, l = sphere(20_000, 1), sphere(20_000, 2)  # noqa: E741
    shape = [0.5, 1.0, 0.2, 0.3]
    there = Takeda2008().lobe(v, l, shape, GRAZING) / l[2]
    back = Takeda2008().lobe(l, v, shape, GRAZING) / v[2]
    assert np.abs(there - back).mean() / there.mean() > 0.3


def test_lift_is_one_at_the_measured_view() -> None:
    l = sphere(10_000)  # noqa: E741
    l = l[:, l[2] > GRAZING]  # noqa: E741
    np.testing.assert_allclose(lobe_lift(N, l, GRAZING), 1, rtol=1e-9)
    x, y = 0.8, -0.5
    np.testing.assert_allclose(diffuse_lift(N, l, x, y, GRAZING), diffuse(l, x, y), atol=1e-9)


def test_flat_facets_are_lambertian_at_every_view() -> None:
    v, l = sphere(1000, 1), sphere(1000, 2)  # noqa: E741
    np.testing.assert_allclose(diffuse_lift(v, l, 0, 0, GRAZING), l[2])


@pytest.mark.parametrize("model", ["slope", "takeda2008"])
@pytest.mark.parametrize("tail", ["gaussian", "ggx"])
def test_albedo_is_the_integral_over_lights(fabric: Callable[..., Material], model: str, tail: str) -> None:
    m = fabric(model, 1, tail, size=(4, 4))
    n = 1 << 14
    k = np.arange(n) + 0.5
    z, turn = k / n, np.pi * (1 + 5**0.5) * k  # a spiral with equal solid angles
    r = np.sqrt(1 - z * z)
    uniform = np.stack([r * np.cos(turn), r * np.sin(turn), z], -1)
    brute = sum(relight(m, part).sum(0) for part in np.array_split(uniform, 16)) * 2 / n
    np.testing.assert_allclose(albedo(m), brute, rtol=0.02)


def test_clamp_brings_the_albedo_to_one(fabric: Callable[..., Material]) -> None:
    m = fabric(size=(6, 6))
    bright = replace(m, channels=m.channels | {"lobe1.amplitude": 4 * m.channels["lobe1.amplitude"]})
    bound = clamp(bright)
    assert bound.min() < 1
    peak = (albedo(bright) * bound[..., None]).max(-1)
    assert peak.max() <= 1 + 1e-6
    rec709 = (albedo(bright) @ TO_REC709.T * bound[..., None]).max(-1)
    np.testing.assert_allclose(np.maximum(peak, rec709)[bound < 1], 1, rtol=1e-5)


@pytest.mark.parametrize("degrees", [0, 30, 60, 80])
def test_extrapolated_albedo_stays_near_that_of_the_measured_view(degrees: float) -> None:
    """Narrow lobe of facets parallel to the fabric: the lift makes no energy and masks at most a sixth."""
    angle = np.radians(degrees)
    v = (np.sin(angle), 0.0, np.cos(angle))
    x, y = np.meshgrid(np.linspace(-0.3, 0.3, 401), np.linspace(-0.3, 0.3, 401))
    z = 1 / np.sqrt(1 + x * x + y * y)
    h = np.stack([x * z, y * z, z])
    dot = h[0] * v[0] + h[2] * v[2]
    l = 2 * dot * h - np.array(v)[:, None, None]  # noqa: E741
    value = Slope().lobe(v, l, [0.0, 0.0, 0.0025, 0.0, 0.0025], GRAZING)
    solid = 4 * np.maximum(dot, 0) * z**3 * (0.6 / 400) ** 2
    kept = (value * solid * (l[2] > 0)).sum() / (4 * np.pi * 0.0025)
    assert {0: 0.98, 30: 0.97, 60: 0.94, 80: 0.82}[degrees] < kept < 1.01
