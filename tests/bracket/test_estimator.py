"""The estimator against synthetic 12-bit counts: bias, efficiency, σ, saturation, order."""

import numpy as np
import pytest

from kinran.bracket.estimator import estimate, ratio_sums
from kinran.data.calibration import Response

SECONDS = 2.0 ** (-np.array([14, 20, 24, 30, 36]) / 3)
BLACK = np.full(5, 256.0)
GAIN, READ, CLIP = 1 / 12.1, 20 / 12.1, 3726
RESPONSE = Response(CLIP - 256, GAIN, float(np.hypot(READ, 12**-0.5)))


def expose(electrons: np.ndarray, seconds: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Counts (exposure, n) of sites that collect `electrons` a second."""
    means = electrons * seconds.reshape(-1, *[1] * np.ndim(electrons))
    counts = (rng.poisson(means) + rng.normal(0, READ / GAIN, means.shape)) * GAIN + 256
    return np.clip(np.floor(counts + 0.5), 0, CLIP).astype(np.uint16)


@pytest.mark.parametrize("decade", [3, 4, 5, 6, 7])
def test_unbiased_and_sigma_is_calibrated(decade: int) -> None:
    """Over a decade of radiance: bias ≤ 0.1 % where the signal stands out (4 σ of its mean elsewhere).

    The predicted σ is the true one to 5 %, up to the taper.
    """
    rng = np.random.default_rng(decade)
    electrons = 10 ** rng.uniform(decade, min(decade + 1, 8.0), 100_000)
    rate, sigma, _ = estimate(expose(electrons, SECONDS, rng), BLACK, SECONDS, RESPONSE)
    error = rate / GAIN - electrons
    spread = error.std() / np.sqrt(len(error))
    assert abs(error.mean()) < max(1e-3 * electrons.mean() if decade > 3 else 0.0, 4 * spread)
    assert np.sqrt(np.mean((rate - electrons * GAIN) ** 2 / sigma**2)) == pytest.approx(1, abs=0.05)


def test_as_good_as_the_noise_allows() -> None:
    """RMSE within 3 % of the Cramér–Rao bound of the unsaturated exposures, away from the taper."""
    rng = np.random.default_rng(1)
    for level in (3e3, 1e5, 1.2e6, 3e7):
        electrons = np.full(100_000, level)
        rate, _, _ = estimate(expose(electrons, SECONDS, rng), BLACK, SECONDS, RESPONSE)
        means = level * SECONDS * GAIN
        seen = means < RESPONSE.clip * 0.9
        information = (SECONDS**2 * GAIN**2 / (GAIN * means + RESPONSE.read**2))[seen].sum()
        assert np.sqrt(np.mean((rate / GAIN - level) ** 2)) < 1.03 / np.sqrt(information)


def test_all_saturated_is_a_flagged_lower_bound() -> None:
    """Not averaged (which would be over 20 times too low), but what the shortest exposure shows."""
    counts = np.full((5, 4), CLIP, np.uint16)
    rate, sigma, _ = estimate(counts, BLACK, SECONDS, RESPONSE)
    averaged = (counts - 256.0).sum(0) / SECONDS.sum()
    assert (rate > 20 * averaged).all()
    np.testing.assert_allclose(rate, (CLIP - 256) / SECONDS[-1], rtol=1e-6)
    assert np.isinf(sigma).all()


def test_darkness_keeps_its_negative_values() -> None:
    rng = np.random.default_rng(2)
    rate, sigma, _ = estimate(expose(np.zeros(50_000), SECONDS, rng), BLACK, SECONDS, RESPONSE)
    assert (rate < 0).mean() == pytest.approx(0.5, abs=0.05)
    assert abs(rate.mean()) < 4 * rate.std() / np.sqrt(rate.size)
    assert np.isfinite(sigma).all()


def test_the_order_of_the_exposures_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    counts = expose(10 ** rng.uniform(3, 8.5, (20, 30)), SECONDS, rng)
    black = BLACK + rng.normal(0, 0.3, 5)
    first = estimate(counts, black, SECONDS, RESPONSE)
    order = np.array([3, 0, 4, 2, 1])
    again = estimate(counts[order], black[order], SECONDS[order], RESPONSE)
    np.testing.assert_array_equal(first, again)


def test_one_exposure_or_a_missing_one_is_enough() -> None:
    rng = np.random.default_rng(4)
    electrons = 10 ** rng.uniform(5, 6, 50_000)
    counts = expose(electrons, SECONDS, rng)
    for use in ([2], [0, 1, 3, 4]):
        rate, sigma, _ = estimate(counts[use], BLACK[use], SECONDS[use], RESPONSE)
        seen = np.isfinite(sigma)
        assert (rate / GAIN)[seen].sum() == pytest.approx(electrons[seen].sum(), rel=2e-3)


def test_a_wrong_white_level_is_what_bends_highlights() -> None:
    """Where the method fails: with saturation taken at 4095 instead of 3726, 2.5 % are lost at the worst level.

    With the measured one no level is off by more than 0.2 %.
    """
    rng = np.random.default_rng(5)
    levels = np.repeat(10 ** np.linspace(6, 7, 50), 4000)
    counts = expose(levels, SECONDS, rng)
    worst = []
    for saturation in (4095 - 256, RESPONSE.saturation):
        rate, _, _ = estimate(counts, BLACK, SECONDS, Response(saturation, GAIN, RESPONSE.read))
        bias = (rate / GAIN / levels).reshape(50, -1).mean(1) - 1
        worst.append(np.abs(bias).max())
    assert worst[0] > 0.025
    assert worst[1] < 0.002


def test_black_that_is_one_count_off_bends_dark_silk() -> None:
    """Where the method fails: over 25 % at 10³ electrons a second, under 1 % at 10⁵; so it is measured to 0.1."""
    rng = np.random.default_rng(7)
    for level, least, most in ((1e3, 0.25, 0.5), (1e5, 1e-3, 1e-2)):
        counts = expose(np.full(200_000, level), SECONDS, rng)
        right, _, _ = estimate(counts, BLACK, SECONDS, RESPONSE)
        for off in (-1, 1):
            wrong, _, _ = estimate(counts, BLACK + off, SECONDS, RESPONSE)
            bias = -off * (wrong.mean(dtype=float) / right.mean(dtype=float) - 1)
            assert least < bias < most, (level, off)


def test_the_ratio_of_two_exposures_is_unbiased() -> None:
    """≤ 0.05 % from 10⁵ sites by choosing on one green and measuring on the other."""
    rng = np.random.default_rng(6)
    electrons = np.repeat(10 ** rng.uniform(3, 8, (1, 300, 400)), 4, 0)
    planes, black = expose(electrons, SECONDS, rng), np.full((5, 4, 300), 256.0)
    for longer in range(4):
        top, bottom, sites = ratio_sums(planes, black, longer, RESPONSE.clip).sum(0)
        assert sites > 20_000
        assert top / bottom == pytest.approx(SECONDS[longer] / SECONDS[longer + 1], rel=5e-4)
