"""Errors are what they are defined to be."""

import numpy as np
import pytest

from kinran.base.encoding import parse
from kinran.data import metrics


def test_psnr_by_hand() -> None:
    truth = np.zeros((2, 3), np.float32)
    assert metrics.psnr(truth + 0.1, truth, np.ones_like(truth)) == pytest.approx(20, abs=1e-4)
    assert metrics.psnr(truth, truth, np.ones_like(truth)) == 120
    np.testing.assert_allclose(metrics.decibels([1, 0.1, 0]), [0, 10, 120])


def test_display_is_the_encoding_or_a_logarithm_to_one() -> None:
    light = np.array([0, 0.5, 1, 3], np.float32)
    np.testing.assert_allclose(metrics.to_display(light, parse("srgb"), 1.0)[2:], 1)
    shown = metrics.to_display(light, None, 2.0)
    assert shown[0] == 0
    assert shown[3] == pytest.approx(1)
    assert (np.diff(shown[:3]) > 0).all()
