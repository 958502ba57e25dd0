"""Radiance in the stack's unit from counts a second: corrected for glare, flat field and lamp, where white is 1."""

import numpy as np

from kinran.calibrate.glare import lift, veil
from kinran.data.calibration import CalibratedCamera
from kinran.data.flat_field import divide, nearest
from kinran.data.radiance import Radiance

STRIP = 64
"""Rows that are corrected at a time, to save memory."""


def to_radiance(picture: Radiance, camera: CalibratedCamera, lamp: float, theta: float, phi: float) -> Radiance:
    """Return a picture (y, x, 3) in π·T: a white diffuser that faces the lamp at θ = 0 reads 1.

    Parameters
    ----------
    picture : (y, x, 3)
        Picture in counts per second.
    camera
        Calibrated camera.
    lamp
        Light of the lamp relative to that on the white plate.
    theta, phi
        Direction of the light in degrees, which selects the flat field.
    """
    height, width, _ = picture.value.shape
    flat = nearest(camera.flats, theta, phi)
    light = veil(picture, camera.glare)
    white = np.array(camera.white, np.float32) * np.float32(lamp)
    whole = Radiance(np.empty_like(picture.value), np.empty_like(picture.flags))
    for first in range(0, height, STRIP):
        rows = slice(first, min(first + STRIP, height))
        strip = picture[rows]
        if camera.glare:
            strip = lift(strip, light)
        if flat is not None:
            strip = divide(strip, flat.values(height, width, rows))
        np.divide(strip.value, white, out=whole.value[rows])
        whole.flags[rows] = strip.flags
    return whole
