"""How a set's photographs encode light, as their own values tell.

Light from a matt texel grows with the cosine at its normal. Where many lamps lie off its mirror direction, their values
say which encoding makes that true: the idea of radiometric calibration by photometric stereo [Mongkulmann2011]. Shiny
surfaces break the law, and narrow domes show too little of the cosine. So most sets say less than one may wish.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base.encoding import Encoding
from kinran.capture.sampled_set import SampledSet
from kinran.data.lambert_law import fit_codes

Array = NDArray[np.float64]

CURVED = 2.2
"""Exponent that stands for photographs that are encoded for screens."""
GLARE = math.cos(math.radians(25))
"""Cosine of the angle between half vector and normal within which a value may be a highlight. A choice: at 40° some
real domes have too few lights left."""
GRAZING = 0.1
"""Least cosine at the normal of a light that counts."""
DARK = 4 / 255
"""Value up to which noise and black level say more than light."""
LIGHTS, TEXELS, MOST = 7, 20, 400
"""Fewest lights of a texel for three unknowns, fewest texels of a set, and how many are looked at. Choices."""
LOUD = 0.5
"""Logarithm of the ratio of residuals from which one encoding is taken to be right: `kinran bench doubts` measures how
often that is wrong."""
LAMBERTIAN = 0.025
"""Largest residual, relative to the values, of a surface that is matt enough to say that its values are linear."""
RELIEF, MANY = 0.08, 24
"""Least standard deviation of slopes, and fewest lights, that say so: a flat metal in sRGB of 8 bits, and any metal
under few lights, fits Lambert's law as linear light. `kinran bench doubts` counts such cases."""


@dataclass(frozen=True)
class Evidence:
    """How far values are from Lambert's law.

    Attributes
    ----------
    linear, curved
        Mean absolute residual relative to the values, if they are linear, and if they are encoded for screens: the
        median over texels.
    ratio
        Median over texels of the logarithm of linear over curved.
    relief
        Standard deviation of the surface's slopes, if the values are linear.
    lights
        Number of lights that were looked at.
    """

    linear: float
    curved: float
    ratio: float
    relief: float
    lights: int

    def __str__(self) -> str:
        return f"they differ from Lambert's law by {self.linear:.1%} as linear light, and by {self.curved:.1%} as sRGB"


def weigh(found: SampledSet) -> Evidence | None:
    """Compare a set's values with Lambert's law as linear light, and as encoded for screens.

    Returns
    -------
    Evidence or None
        None where too few lights or texels are left without highlights, shadows and clipped values.
    """
    texels = np.flatnonzero(found.lit)
    texels = texels[:: -(-len(texels) // MOST)] if len(texels) else texels
    count = len(found.codes)
    codes = found.codes.reshape(count, -1)[:, texels].T
    use = ((codes > DARK) & ~found.clipped.reshape(count, -1)[:, texels].T).astype(float)
    codes, use = _enough(codes, use)
    lights = found.directions * found.gains[:, None]
    half = found.directions + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    matt = use.copy()
    for exponent in (1.0, CURVED) if len(codes) else ():
        scaled, _ = fit_codes(codes, use, lights, exponent)
        normals = scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-12)
        matt *= (normals @ half.T < GLARE) & (normals @ found.directions.T > GRAZING)
    codes, use = _enough(codes, matt)
    if len(codes) < TEXELS:
        return None
    scaled, as_linear = fit_codes(codes, use, lights, 1.0)
    _, as_curved = fit_codes(codes, use, lights, CURVED)
    linear, curved = (
        (use * np.abs(codes - predicted)).sum(1) / (use * codes).sum(1) + 1e-6 for predicted in (as_linear, as_curved)
    )
    slopes = scaled[:, :2] / np.maximum(scaled[:, 2:], 1e-12)
    relief = 1.4826 * np.median(np.abs(slopes - np.median(slopes, 0)), 0).max()
    off, off_curved, ratio = (float(np.median(part)) for part in (linear, curved, np.log(linear / curved)))
    return Evidence(off, off_curved, ratio, float(relief), count)


def _enough(codes: Array, use: Array) -> tuple[Array, Array]:
    """Return the texels that have enough values which count."""
    enough = use.sum(1) >= LIGHTS
    return codes[enough], use[enough]


def doubt(evidence: Evidence | None, encoding: Encoding) -> str:
    """Return a sentence where the values contradict an encoding; else an empty text."""
    if evidence is None:
        return ""
    if encoding.exponent == 1:
        if evidence.ratio < LOUD:
            return ""
        said, remedy = "encoded for screens, not linear", "if they are, leave --encoding out"
    else:
        if evidence.ratio > -LOUD or evidence.linear > LAMBERTIAN:
            return ""
        if evidence.relief < RELIEF or evidence.lights < MANY:
            return ""
        said, remedy = f"linear, not {encoding.name}", "if they are, give --encoding linear"
    return f"the photographs look {said}: {evidence}; {remedy}"
