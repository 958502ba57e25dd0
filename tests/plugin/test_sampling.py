"""Sampling: the density that `pdf` gives is the one that `sample` draws from, in every corner."""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from plugin_fabrics import widths

# θ_n, φ_n, dt, dp in radians
CASES = {
    "middle": (0.5, 1.0, 0.2, 0.3),
    "paper's Fig. 6": (np.radians(30), np.radians(145), 0.25, 0.6),
    "pole": (0.0, 0.0, 0.2, 0.5),
    "near the pole": (0.05, 2.0, 0.2, 0.4),
    "wrap at π": (0.5, np.pi - 0.05, 0.2, 0.5),
    "wrap at 2π": (0.5, 2 * np.pi - 0.02, 0.2, 0.5),
    "narrow": (0.5, 1.0, 0.02, 0.05),
    "narrow at the pole": (0.02, 1.0, 0.02, 0.5),
    "anisotropic": (0.4, 1.5, 0.05, 1.2),
    "wide": (0.6, 1.0, 1.5, 4.0),
    "grazing": (1.2, 1.0, 0.3, 0.5),
}
NARROW = ("narrow", "narrow at the pole", "anisotropic")
INCIDENCE = {"0°": 0.0, "45°": np.pi / 4, "80°": np.radians(80)}
MODELS = ("takeda2008", "slope", "slope ggx", "slope two lobes")


def parameters(model: str, case: str) -> dict[str, Any]:
    """Scene dictionary of a lobe at CASES[case]."""
    theta, phi, dt, dp = (float(v) for v in CASES[case])
    if model == "takeda2008":
        lobe = {"theta": theta, "phi": phi, "dt": dt, "dp": dp}
    else:
        t = min(np.tan(theta), 2.5)
        a, b = min(dt * (1 + t * t), 4.0), min(max(dp * t, 0.5 * dt), 4.0)
        xx, xy, yy = widths(a, b, phi)
        lobe = {"x": t * np.cos(phi), "y": t * np.sin(phi), "xx": xx, "xy": xy, "yy": yy}
    result: dict[str, Any] = {"type": "kinran", "model": model.split()[0]}
    result |= {f"lobe1_{name}": float(value) for name, value in lobe.items()}
    if "ggx" in model:
        result["tail"] = "ggx"
    if "two" in model:
        result |= {"lobe2": 0.3, "lobe2_x": -0.2, "lobe2_y": 0.3, "lobe2_xx": 0.1, "lobe2_yy": 0.02}
    return result


def domain(model: str, case: str, wi: list[float]) -> Any:
    """Spherical grid; for narrow lobes turned so that the lobe sits on the equator, where cells are even."""
    from mitsuba.chi2 import SphericalDomain

    theta, phi, _, _ = CASES[case]
    h = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    axis = 2 * np.dot(h, wi) * h - np.array(wi)

    class Turned(SphericalDomain):
        def __init__(self) -> None:
            self.frame = mi.Frame3f(mi.Normal3f(*[float(a) for a in axis / np.linalg.norm(axis)]))

        def map_forward(self, p: Any) -> Any:
            q = super().map_forward(p)
            return self.frame.to_world(mi.Vector3f(q.y, q.z, q.x))

        def map_backward(self, p: Any) -> Any:
            q = self.frame.to_local(p)
            return super().map_backward(mi.Vector3f(q.z, q.x, q.y))

    return Turned() if case in NARROW else SphericalDomain()


def chi2(model: str, case: str, incidence: str, spoil: Any = None) -> Any:
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest

    angle = INCIDENCE[incidence]
    wi = [float(np.sin(angle)), 0.0, float(np.cos(angle))]
    sample, pdf = BSDFAdapter("kinran", parameters(model, case), wi=mi.ScalarVector3f(wi))
    spoiled = pdf if spoil is None else lambda *a: spoil(mi.Vector3f(wi), a[0], pdf)
    return ChiSquareTest(
        domain=domain(model, case, wi),
        sample_func=sample,
        pdf_func=spoiled,
        sample_dim=3,
        sample_count=500_000,
        res=151 if case in NARROW else 101,
        ires=32 if case in NARROW or model == "takeda2008" else 16,
    )


TESTS = len(MODELS) * len(CASES) * len(INCIDENCE)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("incidence", INCIDENCE)
def test_samples_follow_the_density(jit: str, model: str, case: str, incidence: str) -> None:
    test = chi2(model, case, incidence)
    assert test.run(quiet=True, test_count=TESTS), test.messages


@pytest.mark.parametrize("model", MODELS)
def test_samples_follow_the_density_in_each_variant(variant_jit: str, model: str) -> None:
    test = chi2(model, "middle", "45°")
    assert test.run(quiet=True, test_count=TESTS), test.messages


def _without_jacobian(wi: Any, wo: Any, pdf: Any) -> Any:
    return pdf(wo) * dr.dot(wi, dr.normalize(wi + wo)) * 1.1


def _without_sine(wi: Any, wo: Any, pdf: Any) -> Any:
    h = dr.normalize(wi + wo)
    return pdf(wo) * dr.select(h.z < 0.9999, dr.safe_sqrt(1 - h.z * h.z) / dr.safe_acos(h.z), 1)


def _turned(wi: Any, wo: Any, pdf: Any) -> Any:
    s, c = dr.sincos(mi.Float(np.radians(2)))
    return pdf(mi.Vector3f(c * wo.x - s * wo.y, s * wo.x + c * wo.y, wo.z))


def _brighter(wi: Any, wo: Any, pdf: Any) -> Any:
    return 1.05 * pdf(wo)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("spoil", [_without_jacobian, _without_sine, _turned, _brighter])
def test_a_wrong_density_is_rejected(jit: str, model: str, spoil: Any) -> None:
    """Negative controls: the test above can fail."""
    assert not chi2(model, "middle", "45°", spoil).run(quiet=True, test_count=TESTS)


@pytest.mark.parametrize(
    ("model", "component"), [(model, k) for model in MODELS for k in range(3 if "two" in model else 2)]
)
def test_one_component_is_sampled_alone(jit: str, model: str, component: int) -> None:
    from mitsuba.chi2 import BSDFAdapter, ChiSquareTest, SphericalDomain

    context = mi.BSDFContext()
    context.component = component
    sample, pdf = BSDFAdapter("kinran", parameters(model, "middle"), wi=[0.6, 0, 0.8], ctx=context)
    test = ChiSquareTest(SphericalDomain(), sample, pdf, sample_dim=3, sample_count=500_000, ires=32)
    assert test.run(quiet=True, test_count=TESTS), test.messages


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("case", CASES)
def test_weight_is_eval_over_pdf(jit: str, model: str, case: str) -> None:
    bsdf, n, rng = mi.load_dict(parameters(model, case)), 20_000, np.random.default_rng(3)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    si.wi = mi.warp.square_to_uniform_hemisphere(mi.Point2f(rng.random((2, n)).astype(np.float32)))
    context = mi.BSDFContext()
    u = rng.random((3, n)).astype(np.float32)
    bs, weight = bsdf.sample(context, si, mi.Float(u[0]), mi.Point2f(u[1:]))
    value, density = bsdf.eval_pdf(context, si, bs.wo)
    assert dr.all(bsdf.eval(context, si, bs.wo).x == value.x)
    assert dr.all(bsdf.pdf(context, si, bs.wo) == density)
    weight, value, density, drawn = (np.array(a) for a in (weight.x, value.x, density, bs.pdf))
    assert np.isfinite(weight).all()
    assert weight.min() >= 0
    seen = drawn > 1e-3
    assert seen.mean() > 0.3
    np.testing.assert_allclose(drawn[seen], density[seen], rtol=2e-3)
    np.testing.assert_allclose(weight[seen], value[seen] / density[seen], rtol=4e-3, atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("incidence", INCIDENCE)
def test_albedo_by_sampling_is_albedo_by_uniform_directions(jit: str, model: str, incidence: str) -> None:
    """The furnace, twice: no energy is made or lost by the sampler."""
    bsdf, n, rng = mi.load_dict(parameters(model, "middle")), 1 << 20, np.random.default_rng(5)
    si = dr.zeros(mi.SurfaceInteraction3f, n)
    angle = INCIDENCE[incidence]
    si.wi = mi.Vector3f(float(np.sin(angle)), 0, float(np.cos(angle)))
    u = rng.random((5, n)).astype(np.float32)
    _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(u[0]), mi.Point2f(u[1:3]))
    wo = mi.warp.square_to_uniform_hemisphere(mi.Point2f(u[3:]))
    uniform = np.array(bsdf.eval(mi.BSDFContext(), si, wo).x) * 2 * np.pi
    sampled = np.array(weight.x)
    error = np.hypot(sampled.std(), uniform.std()) / np.sqrt(n)
    assert abs(sampled.mean() - uniform.mean()) < 4 * error
    assert error < 0.01 * uniform.mean()
