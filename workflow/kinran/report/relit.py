"""The section of the report in which a reader moves the light: the fitted material, relit on a grid of lights.

The pictures come from `kinran_bsdf.relight.relight` and are tiles of one sheet; the page blends the four nearest.
"""

import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from kinran.base import pictures
from kinran.base.page import data_url
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material
from kinran_bsdf.relight import relight

SIDE = 17
"""Lights along each axis of (l_x, l_y)."""
MOST = 112
"""Most texels along each side of a picture."""
QUALITY = 85
"""Quality of the sheet's WebP, of 100."""


def relit_section(material: Material) -> dict[str, Any]:
    """Sheet of pictures, as a data URL, and its layout."""
    part = middle(material)
    lights = grid(material.theta_max)
    sheet = tiles(part, lights)
    buffer = io.BytesIO()
    Image.fromarray(sheet).save(buffer, "WEBP", quality=QUALITY)
    height, width = part.size
    return {
        "sheet": data_url(buffer.getvalue(), "webp"),
        "side": SIDE,
        "width": width,
        "height": height,
        "rim": math.sin(material.theta_max),
        "lights": SIDE**2,
        "whole": part.size == material.size,
    }


def middle(material: Material) -> Material:
    """The middle of the fabric, up to `MOST` texels along each side."""
    height, width = material.size
    top, left = max(0, height - MOST) // 2, max(0, width - MOST) // 2
    return material.part(slice(top, top + MOST), slice(left, left + MOST))


def grid(theta_max: float) -> NDArray[np.float64]:
    """Directions (SIDE², 3) evenly spaced in (l_x, l_y), row by row from the top left of the picture.

    Directions below the lowest measured light are moved up to its height.
    """
    rim = math.sin(theta_max)
    along = np.linspace(-rim, rim, SIDE)
    x, y = (v.ravel() for v in np.meshgrid(along, along[::-1]))
    shrink = np.minimum(1, rim / np.maximum(np.hypot(x, y), 1e-9))
    x, y = x * shrink, y * shrink
    return np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], -1)


def tiles(material: Material, lights: NDArray[np.float64]) -> pictures.Picture:
    """Upright pictures under the lights (SIDE², 3), all at one exposure, as one sheet."""
    matrix = np.asarray(TO_REC709 @ material.from_stack, np.float32)
    images = relight(material, lights) @ matrix.T
    exposure = pictures.auto_exposure(images)
    shown = np.stack([pictures.photograph(image, exposure) for image in images])
    _, height, width, _ = shown.shape
    square = shown.reshape(SIDE, SIDE, height, width, 3).swapaxes(1, 2)
    return square.reshape(SIDE * height, SIDE * width, 3)
