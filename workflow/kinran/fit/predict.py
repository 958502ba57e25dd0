"""What fitted lobes say about lights that they were not fitted to."""

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, squared_widths
from kinran.fit.slope import SlopeFit
from kinran_bsdf import models

Samples = NDArray[np.float32]


def predict(
    fitted: SlopeFit, lights: NDArray[np.float64], tail: str = "ggx", slopes: NDArray[np.float64] | None = None
) -> Samples:
    """T (texel, 3, light) of a fit under lights (light, 3), in the unit of its samples, by the plugin's models.

    `slopes` (light, 2) are those of the half vectors where the view is not N.
    """
    s = (frames.slopes(lights) if slopes is None else slopes).astype(np.float32)
    colours = fitted.colours.astype(np.float32)
    bx, by = (fitted.shapes[:, k, None].astype(np.float32) for k in (-DIFFUSE_SIZE, 1 - DIFFUSE_SIZE))
    cosine = models.diffuse(tuple(lights.T.astype(np.float32)), bx, by)
    total = colours[:, -1, :, None] * cosine[:, None]
    for k in range(colours.shape[1] - 1):
        p = fitted.shapes[:, LOBE_SIZE * k : LOBE_SIZE * (k + 1)]
        xx, xy, yy = (w[:, None].astype(np.float32) for w in squared_widths(p))
        x, y = p[:, :1].astype(np.float32), p[:, 1:2].astype(np.float32)
        G = models.slope_lobe(s[:, 0], s[:, 1], x, y, xx, xy, yy, tail)
        total += colours[:, k, :, None] * G[:, None]
    return np.asarray(total, np.float32)
