"""The 24-patch colour chart: its published colours, and the matrix from a camera's RGB to ACEScg."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError

Array = NDArray[np.float64]

ROWS, COLUMNS = 4, 6
"""Rows and columns of the chart's patches."""
INSIDE = 0.4
"""Share of a patch's cell, along each side, that is measured: a choice that keeps clear of the patch's border."""

REC709_TO_ACESCG = np.array(
    [
        [0.61313242, 0.33953802, 0.04741670],
        [0.07012438, 0.91639401, 0.01345152],
        [0.02058766, 0.10957457, 0.86978540],
    ]
)
"""Linear Rec. 709 (D65) to ACEScg (AP1, ACES white), with Bradford's adaptation."""


PATCHES = [
    "dark skin",
    "light skin",
    "blue sky",
    "foliage",
    "blue flower",
    "bluish green",
    "orange",
    "purplish blue",
    "moderate red",
    "purple",
    "yellow green",
    "orange yellow",
    "blue",
    "green",
    "red",
    "yellow",
    "magenta",
    "cyan",
    "white",
    "neutral 8",
    "neutral 6.5",
    "neutral 5",
    "neutral 3.5",
    "black",
]
"""Names of the patches, row by row."""
LAMPS = {"xenon": "Kinoton 75P"}
"""Light sources of colour-science by their name here: the measured spectrum of a xenon projector."""
GREYS = slice(18, 24)
"""Grey patches, from white to black."""
GENERATIONS = ("after November 2014", "before November 2014")
"""Generations of the chart, whose colours differ by ΔE00 0.9 in the mean and 2.0 for white."""
MOST_EXCLUDED = 3
"""Most patches that are left out as outliers: a choice."""


def references(lamp: str = "", generation: str = GENERATIONS[0]) -> Array:
    """Return the reference colours (24, 3) of the patches, row by row from dark skin: linear ACEScg, white is 1.

    Parameters
    ----------
    lamp
        Empty for the published colours (CIE xyY under D50, adapted by Bradford); ``xenon`` or a light source of
        colour-science (``D65``, ``A``, …) for the colours of the patches' reflectance spectra under the lamp's
        spectrum, relative to a perfect white.
    generation
        Generation of the ColorChecker that is published, one of `GENERATIONS`; there is one set of spectra.

    Raises
    ------
    InputError
        The lamp has no spectrum.
    """
    colour = _colour()
    if not lamp:
        chart = colour.CCS_COLOURCHECKERS[f"ColorChecker24 - {generation[0].upper()}{generation[1:]}"]
        xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
        return np.asarray(colour.XYZ_to_RGB(xyz, "ACEScg", chart.illuminant, "Bradford"), float)
    name = LAMPS.get(lamp, lamp)
    sources = {**dict(colour.SDS_ILLUMINANTS), **dict(colour.SDS_LIGHT_SOURCES)}
    if name not in sources:
        raise InputError(f"lamp '{lamp}': has no spectrum; give xenon, or an illuminant such as D50, D65 or A")
    shape = colour.SpectralShape(400, 700, 10)
    spectrum = sources[name].copy().align(shape)
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    patches = [sd.copy().align(shape).values for sd in colour.SDS_COLOURCHECKERS["BabelColor Average"].values()]
    weights = cmfs.values * spectrum.values[:, None]
    white = weights.sum(0) / weights[:, 1].sum()
    xyz = np.array(patches) @ weights / weights[:, 1].sum()
    return np.asarray(colour.XYZ_to_RGB(xyz, "ACEScg", colour.XYZ_to_xy(white), "Bradford"), float)


def expand(rgb: Array, degree: int) -> Array:
    """Return the terms (n, 3) of degree 1, or (n, 6) of degree 2: r, g, b, √(rg), √(gb), √(rb) (Finlayson2015, Eq. 6).

    All are of first order in light, so that colours do not depend on the exposure.
    """
    if degree == 1:
        return np.asarray(rgb, float)
    positive = np.maximum(rgb, 0)
    roots = np.sqrt(positive * np.roll(positive, -1, -1))
    return np.concatenate([rgb, roots], -1)


def apply(matrix: Array, rgb: Array) -> Array:
    """Return the colours (..., 3) of camera RGB (..., 3) under a matrix (3, 3) or a root polynomial (3, 6)."""
    return expand(rgb, 1 if matrix.shape[1] == 3 else 2) @ matrix.T


def fit_matrix(camera: Array, reference: Array, degree: int = 1) -> Array:
    """Fit a matrix (3, 3) or (3, 6) from camera RGB to reference RGB by least squares that keeps white, (1, 1, 1).

    Parameters
    ----------
    camera : (n, 3) float
        Colours relative to the white plate, on any common scale.
    reference : (n, 3) float
        Reference colours.
    degree
        1 for a matrix, 2 for a root polynomial.
    """
    scaled = expand(scale(camera, reference) * camera, degree)
    # rows sum to 1: fit what the differences to the third channel explain
    others = [k for k in range(scaled.shape[1]) if k != 2]
    A, B = scaled[:, others] - scaled[:, [2]], reference - scaled[:, [2]]
    solution = np.linalg.lstsq(A, B, rcond=None)[0].T
    return np.insert(solution, 2, 1 - solution.sum(1), axis=1)


def leave_one_out(camera: Array, reference: Array, degree: int = 1) -> Array:
    """Return the leave-one-out ΔE00 (n,) of each patch: under the matrix fitted to all others."""
    return held_out_errors(camera, reference, np.ones(len(camera), bool), degree)


def held_out_errors(camera: Array, reference: Array, used: NDArray[np.bool_], degree: int) -> Array:
    """Return the leave-one-out ΔE00 (n,) of each patch: under the matrix fitted to the others that are `used`."""
    predicted, level = np.empty_like(reference), scale(camera[used], reference[used])
    for k in range(len(camera)):
        others = used & (np.arange(len(camera)) != k)
        predicted[k] = apply(fit_matrix(camera[others], reference[others], degree), level * camera[k])
    return delta_e(predicted, reference)


def outliers(camera: Array, reference: Array) -> NDArray[np.bool_]:
    """Return which patches (n,), three at most, are outliers, such as under a highlight or dirt.

    The patch with the largest leave-one-out ΔE00 is removed as long as that is over 5 and over four times the median:
    a choice.
    """
    out = np.zeros(len(camera), bool)
    for _ in range(MOST_EXCLUDED):
        kept = np.flatnonzero(~out)
        errors = leave_one_out(camera[kept], reference[kept])
        worst = int(np.argmax(errors))
        if errors[worst] < max(5.0, 4 * float(np.median(errors))):
            break
        out[kept[worst]] = True
    return out


def delta_e(a: Array, b: Array) -> Array:
    """Return ΔE00 (n,), CIE 2000, between linear ACEScg colours (n, 3), relative to ACEScg's white."""
    colour = _colour()
    space = colour.RGB_COLOURSPACES["ACEScg"]
    lab = []
    for rgb in (a, b):
        xyz = colour.RGB_to_XYZ(rgb, space, apply_cctf_decoding=False)
        lab.append(colour.XYZ_to_Lab(xyz, space.whitepoint))
    return np.asarray(colour.delta_E(*lab, method="CIE 2000"), float)


def scale(camera: Array, reference: Array) -> float:
    """Return the factor that scales the camera's neutral patches (n, 3) to the reference ones."""
    grey = reference.mean(1)
    neutral = np.abs(reference - grey[:, None]).max(1) < 0.1 * grey
    if not neutral.any():
        neutral[:] = True
    return float((camera[neutral] * reference[neutral]).sum() / (camera[neutral] ** 2).sum())


def _colour() -> Any:
    """Import colour-science without its warning that matplotlib is missing."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour

        return colour
