"""Veiling glare: the share of a picture's light that lens and camera spread over all of it."""

import numpy as np
from numpy.typing import NDArray

from kinran.data.radiance import HOT, SATURATED, Image, Radiance

Array = NDArray[np.float64]

SURE = 3.0
"""A veil under so many standard deviations is none."""
TOLERANCE = 0.04
"""How well the reflectance of a grey patch is known, relative; of the darkest ones it is worst."""


def estimate_glare(grey: Array, reflectance: Array, mean: float) -> float:
    """Share of the mean light that lies over the grey patches of a chart; 0 if it is not sure.

    A veil is what is left where reflectance goes to 0: the patches read a ρ + b, of which b is the veil. The patches
    count by the tolerance of their reflectance.

    Parameters
    ----------
    grey : (n,) float
        Light of the grey patches.
    reflectance : (n,) float
        What they reflect.
    mean
        Mean light of the whole picture.
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
    """(3,) light of a veil of this share of the mean light of a picture (y, x, 3), channel by channel.

    The lens sees `light + share · mean(light)`, so that the mean of what it shows is (1 + share) times that of light.
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
    """Picture (y, x, 3) without a veil (3,); saturated samples are lower bounds, and stay them with it."""
    return picture.with_value(np.where(picture.has(SATURATED), picture.value, picture.value - light))
