"""Calibration targets of the virtual camera: a white plate and a 24-patch chart, both perfectly diffuse."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Image = NDArray[np.float32]

CHART = np.array(
    [
        (0.1737, 0.0788, 0.0529),  # dark skin
        (0.5598, 0.2774, 0.2109),  # light skin
        (0.1042, 0.1889, 0.3289),  # blue sky
        (0.1057, 0.1508, 0.0508),  # foliage
        (0.2274, 0.2124, 0.4264),  # blue flower
        (0.1153, 0.5074, 0.4111),  # bluish green
        (0.7459, 0.2021, 0.0299),  # orange
        (0.0587, 0.1012, 0.3877),  # purplish blue
        (0.5601, 0.0802, 0.1146),  # moderate red
        (0.1092, 0.0420, 0.1381),  # purple
        (0.3328, 0.4974, 0.0426),  # yellow green
        (0.7710, 0.3579, 0.0204),  # orange yellow
        (0.0210, 0.0475, 0.2841),  # blue
        (0.0461, 0.2920, 0.0615),  # green
        (0.4462, 0.0364, 0.0406),  # red
        (0.8417, 0.5744, 0.0047),  # yellow
        (0.5223, 0.0778, 0.2893),  # magenta
        (-0.0439, 0.2337, 0.3772),  # cyan
        (0.8795, 0.8850, 0.8342),  # white
        (0.5845, 0.5922, 0.5845),  # neutral 8
        (0.3577, 0.3671, 0.3653),  # neutral 6.5
        (0.1901, 0.1909, 0.1898),  # neutral 5
        (0.0859, 0.0887, 0.0898),  # neutral 3.5
        (0.0314, 0.0315, 0.0323),  # black
    ]
)
"""ColorChecker after November 2014: linear Rec. 709 of its CIE xyY (D50), adapted to D65 by Bradford's transform."""
ROWS, COLUMNS = 4, 6
"""Rows and columns of the chart's patches."""
GAP = 0.15
"""Share of a patch's cell that is black card, on each side: made up."""


def white(light: ArrayLike, field_mm: float, texels: int, lamp_mm: float) -> Image:
    """Return the radiance π·T (texels, texels, 3) of a perfect white diffuser under a point lamp; row 0 is v = 0.

    Parameters
    ----------
    light : (3,) float
        Unit vector from the middle of the field to the lamp.
    field_mm
        Side of the square field.
    texels
        Texels along each side.
    lamp_mm
        Distance of the lamp from the middle of the field.
    """
    centres = ((np.arange(texels) + 0.5) / texels - 0.5) * field_mm
    x, y = np.meshgrid(centres, centres)
    to_lamp = lamp_mm * np.asarray(light, float) - np.stack([x, y, np.zeros_like(x)], -1)
    distance = np.linalg.norm(to_lamp, axis=-1)
    irradiance = lamp_mm**2 * np.maximum(to_lamp[..., 2], 0) / distance**3
    return np.repeat(irradiance[..., None], 3, -1).astype(np.float32)


def chart(light: ArrayLike, field_mm: float, texels: int, lamp_mm: float) -> Image:
    """Return the radiance π·T (texels, texels, 3), linear Rec. 709, of the chart over the whole field.

    Dark skin is at the top left; parameters are those of `white`.
    """
    along = (np.arange(texels) + 0.5) / texels
    row, column = (1 - along[:, None]) * ROWS, along[None, :] * COLUMNS
    patch = row.astype(int) * COLUMNS + column.astype(int)
    inside = (np.abs(row % 1 - 0.5) < 0.5 - GAP) & (np.abs(column % 1 - 0.5) < 0.5 - GAP)
    reflectance = np.where(inside[..., None], CHART[patch], 0.02)
    return (reflectance * white(light, field_mm, texels, lamp_mm)).astype(np.float32)
