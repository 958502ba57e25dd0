"""The 24-patch colour chart: its published colours, and the matrix from a camera's RGB to ACEScg."""

import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS, COLUMNS = 4, 6
INSIDE = 0.4
"""Share of a patch's cell, along each side, that is measured."""

REC709_TO_ACESCG = np.array(
    [
        [0.61313242, 0.33953802, 0.04741670],
        [0.07012438, 0.91639401, 0.01345152],
        [0.02058766, 0.10957457, 0.86978540],
    ]
)
"""Linear Rec. 709 (D65) to ACEScg (AP1, ACES white), adapted by Bradford."""


def references() -> Array:
    """(24, 3) linear ACEScg of the patches under a white of 1, row by row from dark skin.

    CIE xyY of the ColorChecker after November 2014 under D50, adapted by Bradford.
    """
    colour = _colour()
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    xyz = colour.xyY_to_XYZ(np.array(list(chart.data.values())))
    return np.asarray(colour.XYZ_to_RGB(xyz, "ACEScg", chart.illuminant, "Bradford"), float)


def patches(image: NDArray[np.float32], usable: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Mean colours of the patches of a chart that fills the picture, dark skin at the top left.

    Parameters
    ----------
    image : (y, x, 3) float32
        Row 0 is the bottom.
    usable : (y, x) bool

    Returns
    -------
    colours : (24, 3) float
    seen : (24,) bool
        Patches all of whose middle is usable.
    """
    height, width = usable.shape
    row = (height - np.arange(height) - 0.5) / height * ROWS
    column = (np.arange(width) + 0.5) / width * COLUMNS
    colours, seen = np.zeros((ROWS * COLUMNS, 3)), np.zeros(ROWS * COLUMNS, bool)
    for k in range(ROWS * COLUMNS):
        r, c = divmod(k, COLUMNS)
        rows = np.abs(row - r - 0.5) <= max(INSIDE / 2, 0.5 * ROWS / height)
        columns = np.abs(column - c - 0.5) <= max(INSIDE / 2, 0.5 * COLUMNS / width)
        box = np.ix_(rows, columns)
        colours[k] = image[box].reshape(-1, 3).mean(0, dtype=float)
        seen[k] = usable[box].all()
    return colours, seen


def fit_matrix(camera: Array, reference: Array) -> Array:
    """Matrix (3, 3) of least squares from camera RGB to reference RGB that keeps white, (1, 1, 1).

    Parameters
    ----------
    camera : (n, 3) float
        Colours relative to the white plate, on any common scale.
    reference : (n, 3) float
    """
    scaled = _scale(camera, reference) * camera
    # rows sum to 1: fit what the differences to the third channel explain
    A, B = scaled[:, :2] - scaled[:, 2:], reference - scaled[:, 2:]
    two = np.linalg.lstsq(A, B, rcond=None)[0].T
    return np.column_stack([two, 1 - two.sum(1)])


def leave_one_out(camera: Array, reference: Array) -> Array:
    """(n,) ΔE00 of each patch under the matrix that was fitted to the others."""
    predicted = np.empty_like(reference)
    for k in range(len(camera)):
        others = np.arange(len(camera)) != k
        matrix = fit_matrix(camera[others], reference[others])
        predicted[k] = _scale(camera, reference) * matrix @ camera[k]
    return delta_e(predicted, reference)


def delta_e(a: Array, b: Array) -> Array:
    """ΔE00 (CIE 2000) of linear ACEScg colours (n, 3), under their own white."""
    colour = _colour()
    space = colour.RGB_COLOURSPACES["ACEScg"]
    lab = []
    for rgb in (a, b):
        xyz = colour.RGB_to_XYZ(rgb, space, apply_cctf_decoding=False)
        lab.append(colour.XYZ_to_Lab(xyz, space.whitepoint))
    return np.asarray(colour.delta_E(*lab, method="CIE 2000"), float)


def _scale(camera: Array, reference: Array) -> float:
    """What brings the camera's neutral patches to the level of the published ones."""
    grey = reference.mean(1)
    neutral = np.abs(reference - grey[:, None]).max(1) < 0.1 * grey
    return float((camera[neutral] * reference[neutral]).sum() / (camera[neutral] ** 2).sum())


def _colour() -> Any:
    """colour-science, without its remark that there is no matplotlib."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        import colour

        return colour
