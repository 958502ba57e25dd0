"""The paper's four steps, on data of Eq. 3 itself."""

import numpy as np
from synthetic_texels import grid, sampled

from kinran.base import frames
from kinran.fit import takeda
from kinran_bsdf.models import Takeda2008


def test_recovers_eq_3_on_the_grid() -> None:
    """The peak lies on the grid, so that steps 1 to 4 have what they assume."""
    lights = grid(5, 72)
    theta, phi = frames.angles(frames.half_vector(lights))
    theta_n, phi_n, dt, dp = np.radians(20), np.radians(145), 0.15, 0.4
    C_s, C_d = np.array([2.0, 1.5, 0.7]), np.array([0.3, 0.05, 0.05])
    G = Takeda2008.of_angles(theta, phi, theta_n, phi_n, dt, dp)
    T = (C_s[:, None] * G + C_d[:, None] * lights[:, 2])[None].astype(np.float32)
    found = takeda.four_steps(sampled(T, lights), np.radians(2.5), np.radians(2.6))
    np.testing.assert_allclose(found.shapes[0], [theta_n, phi_n, dt, dp], rtol=0.02)
    np.testing.assert_allclose(found.colours[0, 0], C_s, rtol=0.01)
    np.testing.assert_allclose(found.colours[0, 1], C_d, atol=0.01)


def test_azimuth_wraps() -> None:
    """A lobe at 355° is as wide as one at 180°."""
    lights = grid(5, 72)
    theta, phi = frames.angles(frames.half_vector(lights))
    widths = []
    for degrees in (180, 355, 0):
        G = Takeda2008.of_angles(theta, phi, np.radians(20), np.radians(degrees), 0.15, 0.4)
        T = np.repeat(G[None, None], 3, 1).astype(np.float32)
        widths.append(takeda.four_steps(sampled(T, lights), np.radians(2.5), np.radians(2.6)).shapes[0, 3])
    np.testing.assert_allclose(widths, widths[0], rtol=1e-3)


def test_peak_at_the_pole_is_flat_in_azimuth_and_finite() -> None:
    lights = grid(5, 24)
    s = frames.slopes(lights)
    T = np.exp(-(s**2).sum(1) / 0.01)[None, None].repeat(3, 1).astype(np.float32)
    found = takeda.four_steps(sampled(T, lights), np.radians(2.5), np.radians(7.6))
    assert found.shapes[0, 0] == 0
    assert found.shapes[0, 3] == takeda.FLAT
    assert np.isfinite(found.shapes).all()


def test_black_texels_stay_finite() -> None:
    found = takeda.four_steps(sampled(np.zeros((2, 3, 385), np.float32), grid()), 0.04, 0.1)
    assert np.isfinite(found.shapes).all()
    np.testing.assert_array_equal(found.colours, 0)
