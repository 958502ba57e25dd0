"""Colours of a material file in Mitsuba's working spaces: linear Rec.709, luminance, or spectra.

In spectral variants a colour is a sum of three spectral primaries [Mallett2019]: the smoothest three that are
non-negative, add up to 1 at each wavelength, and give back Rec.709 under D65. So colour stays linear in every variant:
it can be filtered, averaged into a pyramid and optimised, and values above 1 do not saturate.
"""

from typing import Any

import drjit as dr
import numpy as np

from kinran_bsdf.arrays import Map, mi

TO_REC709 = np.array(
    [
        [1.704858676, -0.621716022, -0.083299372],
        [-0.130076824, 1.140735775, -0.010559802],
        [-0.023964073, -0.128975508, 1.153014019],
    ]
)
"""ACEScg (AP1, ACES white) to linear Rec. 709 (D65), with Bradford's adaptation."""
LUMINANCE = np.array([0.212671, 0.715160, 0.072169])
"""Luminance of linear Rec. 709: the middle row of its matrix to CIE XYZ, with the digits of Mitsuba's ``luminance``."""

FIRST, STEP = 380.0, 10.0
"""First wavelength of the primaries, and step, in nm."""
RED = np.array(
    [0.02831, 0.02829, 0.02822, 0.02792, 0.02692, 0.02424, 0.02008, 0.01852, 0.02929, 0.01199]
    + [0.0] * 9
    + [0.01534, 0.20631, 0.47757, 0.73938, 0.9246]
    + [1.0] * 13
)
BLUE = np.array(
    [0.97169, 0.97171, 0.97178, 0.97208, 0.97308, 0.97576, 0.97992, 0.98148, 0.97071, 0.87847]
    + [0.70497, 0.49203, 0.2838, 0.11226, 0.009, 0.0, 0.0, 0.0, 0.0, 0.04692, 0.052, 0.03436, 0.0124]
    + [0.0] * 14
)
"""Red and blue primaries from 380 to 740 nm; green is 1 minus both. They solve the problem of Mallett2019 for Mitsuba's
D65 and colour-matching functions. The program that solved it is not kept; `tests/plugin/test_colours.py` checks that
they give back Rec. 709."""


def pack(colour: Map, bands: int) -> Map:
    """Convert ACEScg (..., 3) to linear Rec. 709 (..., 3) or its luminance (..., 1); negative components become 0."""
    rec709 = np.maximum(colour @ TO_REC709.T, 0)
    return (rec709 @ LUMINANCE[:, None] if bands == 1 else rec709).astype(np.float32)


class Primaries:
    """Spectral primaries, which turn packed bands into a spectrum of the current variant."""

    def __init__(self) -> None:
        self.table = None
        if mi.is_spectral:
            values = np.stack([RED, 1 - RED - BLUE, BLUE], -1).astype(np.float32)
            self.table = mi.Texture1f(
                mi.TensorXf(values), filter_mode=dr.FilterMode.Linear, wrap_mode=dr.WrapMode.Clamp
            )

    def at(self, wavelengths: Any, active: Any) -> list[list[Any]] | None:
        """Return the three primaries' values at each wavelength; None where colours are not spectral."""
        if self.table is None:
            return None
        size = self.table.shape[0]
        return [self.table.eval(((w - FIRST) / STEP + 0.5) / size, active) for w in wavelengths]

    @staticmethod
    def spectrum(values: list[Any], primaries: list[list[Any]] | None) -> Any:
        """Return the spectrum of packed bands `values`, with the primaries at the ray's wavelengths."""
        if mi.is_monochromatic and len(values) == 3:
            return mi.UnpolarizedSpectrum(sum(v * float(y) for v, y in zip(values, LUMINANCE, strict=True)))
        if primaries is None:
            return mi.UnpolarizedSpectrum(*values)
        return mi.UnpolarizedSpectrum(*[sum(v * p for v, p in zip(values, row, strict=True)) for row in primaries])
