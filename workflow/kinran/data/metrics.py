"""Errors of predicted radiance against held-out photographs."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran.base.encoding import Encoding
from kinran_bsdf import residual

Images = NDArray[np.float32]

LOG_COMPRESSION = residual.LOG_COMPRESSION
"""Peak over the radiance at which the logarithm of `to_display` bends. It is the plugin's constant, since a material's
residual lives in the same values."""
FAINTEST = 1e-12
"""Least mean squared error, 120 dB: equal images get a finite number. Float32 values in [0, 1] are rounded to 6e-8."""


def relative_error(predicted: Images, truth: Images, valid: Images, weight: NDArray[np.float64]) -> float:
    """√(Σ w (m - g)² / Σ w g²) over lights, texels and channels.

    It weighs energy: highlights decide it.

    Parameters
    ----------
    predicted, truth : (light, texel, 3) float32
    valid : (light, texel, 3) float32
        0 for samples that are saturated or defect.
    weight : (light,) float
        Share of the sphere that a light stands for.
    """
    w = weight[:, None, None] * valid
    bottom = float((w * truth.astype(float) ** 2).sum())
    return float(np.sqrt((w * (predicted.astype(float) - truth) ** 2).sum() / bottom)) if bottom > 0 else 0.0


def psnr(display_predicted: Images, display_truth: Images, valid: Images) -> float:
    """Peak signal-to-noise ratio, in dB, of values in [0, 1]; at most 120."""
    total = float(valid.sum())
    square = float((valid * (display_predicted.astype(float) - display_truth) ** 2).sum()) / max(total, 1)
    return float(decibels(square))


def decibels(mean_square: ArrayLike) -> NDArray[np.float64]:
    """Peak signal-to-noise ratios, in dB, of mean squared errors of values in [0, 1]; at most 120."""
    return np.asarray(-10 * np.log10(np.maximum(mean_square, FAINTEST)))


def to_display(light: Images, encoding: Encoding | None, peak: float) -> Images:
    """Values as they are shown: the set's own encoding, or log-compressed radiance up to `peak`."""
    if encoding is not None:
        return encoding.encode(light)
    compressed = np.log1p(LOG_COMPRESSION * np.clip(light, 0, peak) / peak) / np.log1p(LOG_COMPRESSION)
    return np.asarray(compressed, np.float32)
