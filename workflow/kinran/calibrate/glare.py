"""Veiling glare: the share of a picture's mean light that lens and camera spread evenly over it."""

import numpy as np
from numpy.typing import NDArray

from kinran.data.radiance import HOT, SATURATED, Image, Radiance

Array = NDArray[np.float64]

SURE = 3.0
"""Number of standard deviations that a veil must exceed to be corrected."""
TOLERANCE = 0.04
"""Relative standard deviation of a grey patch's reflectance: a choice; it is worst for the darkest patches."""


def estimate_glare(grey: Array, reflectance: Array, mean: float) -> float:
    """Estimate the veiling glare from the grey patches of a chart.

    The patches read a ρ + b for a reflectance ρ, and b is the veil. In the least squares fit, each patch is weighted by
    the tolerance of its reflectance.

    Parameters
    ----------
    grey : (n,) float
        Light of the grey patches.
    reflectance : (n,) float
        Reflectance of the patches.
    mean
        Mean light of the whole picture.

    Returns
    -------
    float
        Veil over the mean light of the picture; 0 where it is not significant.
    """
    if len(grey) < 4 or mean <= 0:
        return 0.0
    w = 1 / (TOLERANCE * reflectance)
    A = np.stack([reflectance, np.ones_like(reflectance)], 1) * w[:, None]
    scale = float((grey * w) @ A[:, 0] / (A[:, 0] @ A[:, 0]))
    (slope, veil), *_ = np.linalg.lstsq(A, grey / scale * w, rcond=None)
    spread = float(np.sqrt(np.linalg.inv(A.T @ A)[1, 1]))
    residual = A @ np.array([slope, veil]) - grey / scale * w
    spread *= min(1.0, float(np.sqrt(np.mean(residual**2) * len(grey) / (len(grey) - 2))) + 0.05)
    if veil < SURE * spread:
        return 0.0
    return float(veil * scale / mean)


def veil(picture: Radiance, share: float) -> Image:
    """Return the light (3,) of a veil of this share of a picture's (y, x, 3) mean light, channel by channel.

    The picture is light + share · mean(light), so that its mean is (1 + share) times that of the light.
    """
    if not share:
        return np.zeros(3, np.float32)
    height, width, _ = picture.value.shape
    hot = picture.has(HOT)
    along = picture.value.reshape(height, -1).sum(0, dtype=float)  # rows first: three times as fast
    total = along.reshape(width, 3).sum(0)
    channel = np.nonzero(hot)[2]
    total -= np.bincount(channel, picture.value[hot], 3)
    means = total / (height * width - np.bincount(channel, minlength=3))
    return np.asarray(share / (1 + share) * means, np.float32)


def lift(picture: Radiance, light: Image) -> Radiance:
    """Return a picture (y, x, 3) without a veil (3,); saturated samples, which are lower bounds, stay as they are."""
    return picture.with_value(np.where(picture.has(SATURATED), picture.value, picture.value - light))
