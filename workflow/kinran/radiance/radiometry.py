"""From counts a second to the stack's unit: free of glare, flat field and lamp, white is 1."""

import numpy as np
from numpy.typing import NDArray

from kinran.radiance.calibration import Camera
from kinran.radiance.flat import divide, nearest
from kinran.radiance.glare import remove_glare

Image = NDArray[np.float32]
Flags = NDArray[np.uint8]


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
    value = remove_glare(rate, flags, camera.glare)
    flat = nearest(camera.flats, theta, phi)
    if flat is not None:
        value, flags = divide(value, flags, flat.values(*rate.shape[:2]))
    return np.asarray(value / (np.array(camera.white, np.float32) * np.float32(lamp)), np.float32), flags
