"""Errors of predicted radiance against held-out photographs."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.encoding import Encoding
from kinran_bsdf import residual

Images = NDArray[np.float32]

LOG_COMPRESSION = residual.LOG_COMPRESSION
"""Factor 500 in ln(1 + 500 x / peak), the curve of `to_display`. It is the plugin's constant, since a material's
residual is modelled in the same values."""
FAINTEST = 1e-12
"""Least mean squared error, 120 dB, so that equal images get a number. Float32 rounds values in [0, 1] to 6e-8."""


def psnr(display_predicted: Images, display_truth: Images, valid: Images) -> float:
    """Return the peak signal-to-noise ratio in dB of values (...) in [0, 1]; at most 120."""
    total = float(valid.sum())
    square = float((valid * (display_predicted.astype(float) - display_truth) ** 2).sum()) / max(total, 1)
    return float(decibels(square))


def decibels(mean_square: ArrayLike) -> NDArray[np.float64]:
    """Return peak signal-to-noise ratios (...) in dB of mean squared errors (...) of values in [0, 1]; at most 120."""
    return np.asarray(-10 * np.log10(np.maximum(mean_square, FAINTEST)))


def to_display(light: Images, encoding: Encoding | None, peak: float) -> Images:
    """Return values in [0, 1] for display of linear light (...): by the set's encoding, or of log-compressed radiance.

    Without an encoding they are ln(1 + 500 x / peak) / ln(501), where radiance x is clipped to [0, peak].
    """
    if encoding is not None:
        return encoding.encode(light)
    compressed = np.log1p(LOG_COMPRESSION * np.clip(light, 0, peak) / peak) / np.log1p(LOG_COMPRESSION)
    return np.asarray(compressed, np.float32)
