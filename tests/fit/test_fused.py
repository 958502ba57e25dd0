"""The fast solver reaches the cost of the reference in double precision."""

import numpy as np
import pytest
from scipy.optimize import OptimizeResult, least_squares, nnls
from synthetic_texels import radiance, sampled, texels

from kinran.base import frames
from kinran.fit import samples, slope
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.lobes import TAILS, squared_widths
from kinran.fit.solver.rows import lobe_rows
from kinran.fit.solver.start import pair
from kinran_bsdf.models import Slope
from kinran_bsdf.models.lambert import diffuse


def reference(given: Samples, lobes: Lobes, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (texel, K) and costs (texel,) of variable projection by SciPy, in double precision, from these shapes."""
    found = [
        _reference(T, W, given.under.directions, lobes, p) for T, W, p in zip(given.T, given.W, starts, strict=True)
    ]
    return np.stack([one.x for one in found]), np.array([2 * one.cost for one in found])


def _reference(T: np.ndarray, W: np.ndarray, lights: np.ndarray, lobes: Lobes, start: np.ndarray) -> OptimizeResult:
    s, root = frames.slopes(lights), np.sqrt(W.astype(float))

    def left(p: np.ndarray) -> np.ndarray:
        """Weighted residuals of the best colours for these shapes."""
        shapes = [p[5 * k : 5 * k + 5] for k in range(lobes.count)]
        columns = [Slope(lobes.tail).of_slopes(*s.T, q[0], q[1], *squared_widths(q)) for q in shapes]
        A = root[:, None] * np.stack([*columns, diffuse(lights.T, p[-2], p[-1])], 1)
        return np.concatenate([A @ nnls(A, b)[0] - b for b in root * T.astype(float)])

    return least_squares(left, start, method="lm", x_scale=0.1)


COUNT = 60
"""Texels that the reference is run on."""


def noisy(clean: np.ndarray) -> np.ndarray:
    rng = np.random.default_rng(1)
    return (clean * (1 + 0.02 * rng.normal(size=clean.shape)) + 0.003 * rng.normal(size=clean.shape)).astype("f4")


@pytest.mark.parametrize("tail", TAILS)
def test_one_lobe(lights: np.ndarray, tail: str) -> None:
    """To 0.1 % in cost for 95 % of the texels, with weights that differ by sample; median slopes to 0.001."""
    shapes, colours = texels(COUNT)
    W = np.random.default_rng(2).choice([0.0, 0.5, 2.0], (COUNT, len(lights)), p=[0.1, 0.45, 0.45]).astype(np.float32)
    given = sampled(noisy(radiance(shapes, colours, lights, tail)), lights, W)
    fast, (slow, cost) = slope.fit(given, Lobes(tail), narrow=0.02), reference(given, Lobes(tail), shapes)
    assert (fast.cost < 1.001 * cost).mean() > 0.95
    assert np.median(np.abs(fast.shapes[:, :2] - slow[:, :2])) < 1e-3


def test_one_channel_has_the_optimum_of_three(lights: np.ndarray) -> None:
    """Without a bent diffuse normal the shape is fitted along the highlight's colour alone."""
    shapes, colours = texels(100)
    shapes[:, 5:] = 0
    given = sampled(noisy(radiance(shapes, colours, lights)), lights)
    straight, bent = (slope.fit(given, Lobes(bent=b)) for b in (False, True))
    assert (straight.shapes[:, 5:] == 0).all()
    assert np.median(straight.cost / bent.cost) < 1.01


def test_two_lobes(lights: np.ndarray) -> None:
    """At least as low as the reference from its own start, a wider lobe around the first, for nine texels of ten."""
    one, two, lobes = texels(COUNT), texels(COUNT, seed=9), Lobes("gaussian", 2)
    two[0][:, 2:5] /= 2
    given = sampled(
        noisy(radiance(*one, lights, "gaussian") + radiance(two[0], 0.4 * two[1], lights, "gaussian")), lights
    )
    first, flat = one[0][:, :5], np.zeros((COUNT, 2))
    wider = first * [0.5, 0.5, 1, 0.4, 1] - np.log(2.5) * np.array([0, 0, 1, 0, 1])
    _, cost = reference(given, lobes, np.concatenate([first, wider, flat], 1))
    assert (slope.fit(given, lobes).cost < 1.02 * cost).mean() > 0.9


def test_cost_is_that_of_the_prediction(lights: np.ndarray) -> None:
    """The cost does not come from a difference of large numbers: 1e-3 even where the residual is 1e-3 of the data."""
    clean = radiance(*texels(40), lights)
    T = (clean + 1e-3 * np.random.default_rng(3).normal(size=clean.shape)).astype(np.float32)
    given = sampled(T, lights)
    fitted = slope.fit(given, Lobes())
    direct = ((fitted.predict(given.under).astype(float) - T) ** 2).sum((1, 2))
    np.testing.assert_allclose(fitted.cost, direct, rtol=1e-2)


def test_widths_are_bounded_along_their_axes(lights: np.ndarray) -> None:
    """A lobe at 45° that is thinner than the bound comes back as thin as the bound, not thinner."""
    shapes, colours = texels(20)
    shapes[:, 2:5] = 2.0, -40.0, 2.0
    fitted = slope.fit(sampled(radiance(shapes, colours, lights), lights), Lobes(), narrow=0.1)
    xx, xy, yy = squared_widths(fitted.shapes[:, :5])
    thin = np.sqrt(0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy))
    assert (thin > 0.1 * (1 - 1e-3)).all()


def test_a_given_start_is_kept(lights: np.ndarray) -> None:
    """Without iterations the shapes stay, and every texel's colours are those of its own data."""
    shapes, colours = texels(20)
    shapes[:, 5:] = 0
    given = sampled(radiance(shapes, colours, lights), lights)
    kept = slope.fit(given, Lobes(bent=False), iterations=0, start=shapes)
    np.testing.assert_allclose(kept.shapes, shapes, atol=1e-12)
    np.testing.assert_allclose(kept.colours, colours, rtol=1e-3, atol=1e-4)


def test_a_gaussian_between_lights_is_no_brighter_than_it_has_to_be() -> None:
    """A highlight of 2 that one light of a grid of 0.13 sees: not ten times as bright, or 1e8, where no light is.

    So it is where the region's prior was given no weight; without any prior the lobes are free.
    """
    at = np.stack(np.meshgrid(np.arange(-3, 4), np.arange(-3, 4)), -1).reshape(-1, 2) * 0.13
    half = np.concatenate([at, np.ones((len(at), 1))], 1)
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    lights = 2 * half[:, 2:] * half - [0, 0, 1]
    rng = np.random.default_rng(5)
    T = (0.3 * lights[:, 2] + 0.01 * rng.normal(size=(100, 3, len(lights)))).astype(np.float32)
    T[:, :, len(lights) // 2] += 2
    given, lobes = sampled(T, lights), Lobes("gaussian", 2)
    free = slope.fit(given, lobes, narrow=0.02)
    rejected = [Prior(np.median(free.shapes, 0), 0.0)]
    held = slope.fit(given, lobes, rejected, narrow=0.02)
    assert free.colours[:, :2].max() > 20
    assert held.colours[:, :2].max() < 4


def test_the_two_gaussians_of_a_ggx_lobe() -> None:
    """0.76 and 0.21 high they are the lobe to 3 % of its peak."""
    p = np.zeros(12)
    pair(p)
    q = np.linspace(0, 4, 200) ** 2
    both = 0.76 * np.exp(-q * np.exp(2 * p[2])) + 0.21 * np.exp(-q * np.exp(2 * p[7]))
    assert np.abs(both - (1 + q) ** -2.0).max() < 0.035


def test_gaussian_rows_hold_no_denormals(lights: np.ndarray) -> None:
    """What is far from a narrow lobe is 0: processors multiply denormals a hundred times slower."""
    S = np.ascontiguousarray(frames.slopes(lights[:384]).T, np.float32)
    root, R = np.ones(384, np.float32), np.zeros((8, 384), np.float32)
    p = np.array([0.1, 0.013, -np.log(0.05), 0.3, -np.log(0.05)])
    lobe_rows(TAILS["gaussian"], p, 0, S, root, root.copy(), R, 5)
    products = R[:6, None].astype(float) * R[None, :6]
    for values in (R, products):
        assert ((values == 0) | (np.abs(values) > np.finfo(np.float32).tiny)).all()
    assert (R[5] > 0).any()


def test_denormals_survive() -> None:
    """Fast arithmetic in the solver does not flush what is small anywhere else."""
    assert np.float64(1e-310) * np.float64(1.0) > 0


def test_reordering() -> None:
    """Texels first, in single precision, exactly; weights by the flags of the three channels together."""
    rng = np.random.default_rng(0)
    radiance_ = rng.normal(0, 1, (37, 5, 7, 3)).astype(np.float16)
    radiance_[3, 2, 1, 0], radiance_[4, 2, 1, 0], radiance_[5, 0, 0, 0] = 6e-8, -65504, np.nan
    flags = np.zeros(radiance_.shape, np.uint8)
    flags[5, 3, 2, 1], flags[6, 3, 2, 0], flags[6, 3, 2, 2] = 1, 4, 8
    weight_of = np.arange(256, dtype=np.float32)
    T, W = samples.texels_first(radiance_, flags, weight_of)
    np.testing.assert_array_equal(T, radiance_.reshape(37, 35, 3).transpose(1, 2, 0).astype(np.float32))
    expected = np.zeros((35, 37))
    expected[3 * 7 + 2, 5:7] = 1, 12
    np.testing.assert_array_equal(W, expected)
