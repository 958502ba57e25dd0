"""The compiled lobes are those of the plugin, and their derivatives are right."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from synthetic_texels import grid, radiance, texels

from kinran.data.texel_directions import Under
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, diffuse, lobe, squared_widths
from kinran_bsdf.models import Slope
from kinran_bsdf.models.lambert import diffuse as reference_diffuse

SHAPE = st.tuples(
    st.floats(-0.8, 0.8), st.floats(-0.8, 0.8), st.floats(-0.5, 3.5), st.floats(-10, 10), st.floats(-0.5, 3.5)
)
SLOPE = st.tuples(st.floats(-1, 1), st.floats(-1, 1))


@pytest.mark.parametrize("tail", TAILS)
@given(SHAPE, SLOPE)
def test_value_is_that_of_the_reference(tail: str, shape: tuple[float, ...], s: tuple[float, float]) -> None:
    p = np.array(shape)
    value = lobe(TAILS[tail], p, *s, np.empty(LOBE_SIZE))
    reference = Slope(tail).of_slopes(*s, p[0], p[1], *squared_widths(p))
    assert value == pytest.approx(float(reference), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("tail", TAILS)
@given(SHAPE, SLOPE)
def test_derivatives(tail: str, shape: tuple[float, ...], s: tuple[float, float]) -> None:
    p, exact, unused = np.array(shape), np.empty(LOBE_SIZE), np.empty(LOBE_SIZE)
    lobe(TAILS[tail], p, *s, exact)
    for k in range(LOBE_SIZE):
        step = np.zeros(LOBE_SIZE)
        step[k] = 1e-6
        high, low = (lobe(TAILS[tail], p + sign * step, *s, unused) for sign in (1, -1))
        assert exact[k] == pytest.approx((high - low) / 2e-6, rel=1e-3, abs=1e-5)


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), st.floats(0, 1.5), st.floats(0, 6.28))
def test_diffuse_is_that_of_the_reference(slopes: tuple[float, float], theta: float, phi: float) -> None:
    light = (np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta))
    derivative = np.empty(DIFFUSE_SIZE)
    value = diffuse(np.array(slopes), *light, derivative)
    assert value == pytest.approx(float(reference_diffuse(light, *slopes)), abs=1e-12)
    np.testing.assert_array_equal(derivative, light[:2] if value > 0 else (0, 0))


@pytest.mark.parametrize("tail", TAILS)
def test_a_prediction_is_that_of_the_reference(tail: str) -> None:
    """Two lobes are the sum of two predictions of one, of which the second has no diffuse term."""
    lights = grid(10, 12)
    (one, C), (two, D) = texels(9), texels(9, 1)
    shapes, colours = np.concatenate([one[:, :5], two[:, :5], one[:, 5:]], 1), np.stack([C[:, 0], D[:, 0], C[:, 1]], 1)
    D[:, 1] = 0
    truth = radiance(one, C, lights, tail) + radiance(two, D, lights, tail)
    fitted, far = SlopeFit(Lobes(tail, 2), shapes, colours, np.zeros(9), np.zeros(9, bool)), Under.far(lights)
    np.testing.assert_allclose(fitted.predict(far), truth, rtol=1e-5, atol=1e-6)
    # the slopes of the half vectors count, not those of the directions
    assert np.abs(fitted.predict(replace(far, slopes=0.9 * far.slopes)) - truth).max() > 0.1
