"""From counts a second to the stack's unit: free of glare, flat field and lamp, white is 1."""

import numpy as np
from numpy.typing import NDArray

from kinran.radiance.calibration import Camera
from kinran.radiance.flat import divide, nearest
from kinran.radiance.glare import lift, veil

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]

STRIP = 64
"""Rows at a time, so that what is temporary stays small."""


def to_radiance(
    rate: Image, flags: Flags, camera: Camera, lamp: float, theta: float, phi: float
) -> tuple[Image, Flags]:
    """Picture (y, x, 3) in π·T: a white diffuser that faces the lamp at θ = 0 reads 1.

    Parameters
    ----------
    rate : (y, x, 3) float32
        Counts a second.
    flags : (y, x, 3) uint8
    camera
        Calibrated.
    lamp
        Light of the lamp relative to that on the white plate.
    theta, phi
        Direction of the light in degrees, for its flat field.
    """
    height, width, _ = rate.shape
    flat = nearest(camera.flats, theta, phi)
    light = veil(rate, flags, camera.glare)
    white = np.array(camera.white, np.float32) * np.float32(lamp)
    radiance, bits = np.empty_like(rate), np.empty_like(flags)
    for first in range(0, height, STRIP):
        rows = slice(first, min(first + STRIP, height))
        value, bits[rows] = rate[rows], flags[rows]
        if camera.glare:
            value = lift(value, bits[rows], light)
        if flat is not None:
            value, bits[rows] = divide(value, bits[rows], flat.values(height, width, rows))
        np.divide(value, white, out=radiance[rows])
    return radiance, bits
