"""Statistics over the lights that regions are told apart by."""

import numpy as np

from kinran.segment.appearance import Appearance, median_unclipped


def test_black_and_bright_texels_have_finite_features() -> None:
    median = np.zeros((8, 8, 3), np.float32)
    median[4:] = 1e4
    assert np.isfinite(
        Appearance(median, median[..., 0], median[..., 0], np.ones(median.shape[:2], bool)).features()
    ).all()


def test_chroma_does_not_change_with_brightness() -> None:
    median = np.array([[[0.4, 0.2, 0.1], [0.04, 0.02, 0.01], [0.1, 0.2, 0.4]]], np.float32)
    chroma = Appearance(median, median.max(-1), median.mean(-1), np.ones(median.shape[:2], bool)).features()[:, :2]
    assert np.abs(chroma[0] - chroma[1]).max() < 0.1 * np.abs(chroma[0] - chroma[2]).max()


def test_clipped_samples_do_not_bleach_the_colour() -> None:
    """Gold that clips under most lights is white by the plain median, and gold by that of the other samples."""
    gold = np.array([0.5, 0.4, 0.1], np.float32)
    brightness = np.array([0.5, 0.8, 1.0, 10.0, 10.0, 10.0, 10.0], np.float32)
    samples = np.minimum(gold * brightness[:, None], 1)[:, None, None, :]
    clipped = (samples >= 1).any(-1)
    plain = np.median(samples, axis=0)[0, 0]
    ours = median_unclipped(samples, clipped)[0, 0]
    assert plain[2] / plain[0] > 0.9
    np.testing.assert_allclose(ours / ours[0], gold / gold[0], rtol=1e-6)


def test_a_texel_that_is_always_clipped_keeps_its_median() -> None:
    samples = np.ones((5, 1, 1, 3), np.float32)
    np.testing.assert_array_equal(median_unclipped(samples, np.ones((5, 1, 1), bool)), 1)
