"""Whether the axes of a set's lights are those of its pictures, as the relief tells.

Slopes p = ∂h/∂x and q = ∂h/∂y of a surface have one mixed derivative: ∂p/∂y = ∂q/∂x. Where one axis of the lights is
turned, one slope changes its sign, and both derivatives are opposite. Where two are, the relief is hollow in place of
raised, and this test says nothing [Belhumeur1999].
"""

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding
from kinran.capture.encoding_evidence import CURVED
from kinran.capture.sampled_set import SampledSet
from kinran.data.lambert_law import fit_codes

Array = NDArray[np.float64]

PARTS, FEWEST = 4, 40
"""Parts along a side of the picture that speak for themselves, and the fewest cells of one. Choices."""
LEAST_PARTS = 6
"""Fewest parts of a picture that can agree. A choice."""
LEAST = 0.1
"""Least correlation that says anything."""
ERRORS = 4.0
"""Standard errors, over the parts of the picture, from which a correlation is taken for one."""
STEEP = 5.0
"""Largest slope that counts: that of a texel at 79° to the view."""


def correlate(found: SampledSet, encoding: Encoding) -> tuple[float, float]:
    """Return the correlation of both mixed derivatives of the relief, and its standard error over parts of the picture.

    It is positive where x is right, y up and z towards the camera, and negative where one axis is turned. The error is
    infinite where too little of the picture has a relief.
    """
    lit = found.lit
    count = len(found.codes)
    codes = found.codes.reshape(count, -1)[:, lit.ravel()].T
    use = (~found.clipped.reshape(count, -1)[:, lit.ravel()].T).astype(float)
    lights = found.directions * found.gains[:, None]
    scaled = np.zeros((*lit.shape, 3))
    scaled[lit] = fit_codes(codes, use, lights, 1.0 if encoding.exponent == 1 else CURVED)[0]
    known = lit & (scaled[..., 2] > np.linalg.norm(scaled[..., :2], axis=-1) / STEEP)
    p, q = (-scaled[..., k] / np.where(known, scaled[..., 2], 1) for k in (0, 1))
    cells = known[1:, 1:] & known[:-1, 1:] & known[1:, :-1] & known[:-1, :-1]
    along_y = (p[:-1, :-1] + p[:-1, 1:] - p[1:, :-1] - p[1:, 1:]) / 2  # rows run down, y runs up
    along_x = (q[:-1, 1:] + q[1:, 1:] - q[:-1, :-1] - q[1:, :-1]) / 2
    if not cells.any():
        return 0.0, np.inf
    most = np.quantile(np.abs(np.concatenate([along_y[cells], along_x[cells]])), 0.98)
    a, b = (np.clip(part, -most, most) for part in (along_y, along_x))
    parts = []
    for rows in np.array_split(np.arange(len(cells)), PARTS):
        for columns in np.array_split(np.arange(cells.shape[1]), PARTS):
            inside = np.ix_(rows, columns)
            use_part = cells[inside]
            if use_part.sum() >= FEWEST:
                parts.append(_cosine(a[inside][use_part], b[inside][use_part]))
    error = float(np.std(parts, ddof=1) / np.sqrt(len(parts))) if len(parts) >= LEAST_PARTS else np.inf
    return float(np.mean(parts)) if parts else 0.0, error


def _cosine(a: Array, b: Array) -> float:
    return float((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum() + 1e-30))


def doubt(correlation: float, error: float) -> str:
    """Return a sentence where the relief says that one axis is turned; else an empty text."""
    if correlation > -max(LEAST, ERRORS * error):
        return ""
    return (
        f"the lights look mirrored: the slopes that they give fit together with a correlation of {correlation:.2f},"
        f" and of {-correlation:.2f} with one axis turned; +x is right, +y up: if y points down in the file of lights,"
        " turn its sign"
    )
