"""A bracket of losslessly compressed DNG files with known truth."""

from pathlib import Path

import numpy as np
import pytest

from kinran.bracket import Response, estimate
from kinran.raw import read_raw


@pytest.mark.real
def test_a_compressed_bracket_is_merged_without_bias(real_data: Path) -> None:
    """Per decade of electrons a second, 0.1 % from 10⁴ on; σ to 5 %."""
    data = real_data / "hdr_synth"
    frames = [read_raw(data / f"b_{rate}.dng") for rate in (25, 100, 250, 1000, 4000)]
    seconds = 2.0 ** (-np.array([14, 20, 24, 30, 36]) / 3)
    np.testing.assert_allclose([frame.seconds for frame in frames], seconds, rtol=0.03)
    truth = np.load(data / "truth_e_per_s_f32.npy")
    site = ((0, 0), (0, 1), (1, 0), (1, 1))
    response = Response(3726 - 256, 1 / 12.1, float(np.hypot(20 / 12.1, 12**-0.5)))
    for plane, (row, column) in enumerate(site):
        counts = np.stack([frame.planes[plane] for frame in frames])
        black = np.array([frame.black for frame in frames])
        rate, sigma = estimate(counts, black, seconds, response)
        expected = truth[row::2, column::2][::-1]
        for low in (1e4, 1e5, 1e6, 1e7):
            use = (expected > low) & (expected < 10 * low) & np.isfinite(sigma)
            if use.sum() > 3000:
                bias = (rate[use] / response.gain).sum() / expected[use].sum() - 1
                assert abs(bias) < 1e-3, (plane, low, bias)
                z = (rate[use] - expected[use] * response.gain) / sigma[use]
                assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.05)
