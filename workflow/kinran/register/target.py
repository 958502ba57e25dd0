"""The target around the fabric: a plate of known corners, and their detection in a photograph.

Board coordinates are the fabric's: millimetres from the middle of the plate, X to the right, Y up, Z towards the
camera. Pixels are counted from the corner of the picture, so that the middle of its first pixel is (0.5, 0.5):
OpenCV, which puts it at (0, 0), is corrected here and nowhere else on the way in.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import yaml
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.base.project import ROOT

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

SCHEMA = ROOT / "workflow" / "schemas" / "board.schema.yaml"
CENTRE = 0.5
"""Position of the first pixel's middle: pycolmap counts so, OpenCV counts from 0."""
LEAST = 12
"""Fewest corners of a view that its pose is trusted to: 24 numbers for the 6 of the pose. No measurement stands behind
it."""
SPREAD = 0.25
"""Share of the plate's width and of its height that the corners of a view must span: from a corner of the plate alone a
pose is a guess at its other end. No measurement stands behind the share."""


@dataclass(frozen=True)
class Board:
    """A target: corners of known position around the opening for the fabric.

    Attributes
    ----------
    kind
        ``charuco`` or ``aruco``.
    points : (corner, 3) float
        Positions in mm; Z = 0.
    usable : (corner,) bool
        False where the opening cuts into the corner.
    aperture
        Width and height of the opening in mm; None without one.
    detector
        OpenCV's detector of this board.
    """

    kind: str
    points: Array
    usable: NDArray[np.bool_]
    aperture: tuple[float, float] | None
    detector: Any


@dataclass(frozen=True)
class Corners:
    """The corners that a view shows.

    Attributes
    ----------
    name
        Name of the view.
    ids : (n,) int
        Index of each corner on the board.
    pixels : (n, 2) float
        Positions, x from the left, y from the top; the middle of the first pixel is (0.5, 0.5).
    """

    name: str
    ids: NDArray[np.int64]
    pixels: Array


def read_board(path: Path) -> Board:
    """Read the description of a target.

    Raises
    ------
    InputError
        The file is missing, or is no target that OpenCV knows.
    """
    try:
        spec = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: cannot be read as the YAML file of a board ({error})") from None
    rules = yaml.safe_load(SCHEMA.read_text(encoding="utf-8"))
    wrong = jsonschema.exceptions.best_match(jsonschema.Draft202012Validator(rules).iter_errors(spec))
    if wrong is not None:
        at = ".".join(str(part) for part in wrong.absolute_path)
        raise InputError(f"{path}: {at + ': ' if at else ''}{wrong.message}; see workflow/schemas/{SCHEMA.name}")
    if not hasattr(cv2.aruco, spec["dictionary"]):
        raise InputError(f"{path}: OpenCV has no dictionary '{spec['dictionary']}'; give one such as DICT_5X5_250")
    if spec["marker_mm"] >= spec["pitch_mm"]:
        raise InputError(f"{path}: marker_mm {spec['marker_mm']:g} leaves no gap in pitch_mm {spec['pitch_mm']:g}")
    needed = spec["columns"] * spec["rows"] // (2 if spec["kind"] == "charuco" else 1)
    there = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec["dictionary"])).bytesList)
    if needed > there:
        raise InputError(f"{path}: needs {needed} markers, but {spec['dictionary']} has {there}; give a larger one")
    return make_board(spec)


def make_board(spec: dict[str, Any]) -> Board:
    """Board of a description that fits the schema.

    Corners that the opening touches, or comes nearer to than a quarter of a square, are not usable: what lies
    across the corner is then fabric.
    """
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, spec["dictionary"]))
    size, pitch, marker = (spec["columns"], spec["rows"]), spec["pitch_mm"], spec["marker_mm"]
    detector: Any
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    if spec["kind"] == "charuco":
        chessboard = cv2.aruco.CharucoBoard(size, pitch, marker, dictionary)
        detector = cv2.aruco.CharucoDetector(chessboard, cv2.aruco.CharucoParameters(), parameters)
        flat = np.array(chessboard.getChessboardCorners(), float)
        extent = np.array(size) * pitch
        margin = pitch / 4
    else:
        grid = cv2.aruco.GridBoard(size, marker, pitch - marker, dictionary)
        detector = cv2.aruco.ArucoDetector(dictionary, parameters)
        flat = np.array(grid.getObjPoints(), float).reshape(-1, 3)
        extent = flat[:, :2].max(0)
        margin = marker / 4
    points = np.stack([flat[:, 0] - extent[0] / 2, extent[1] / 2 - flat[:, 1], np.zeros(len(flat))], -1)
    aperture = spec.get("aperture_mm")
    usable = np.ones(len(points), bool)
    if aperture is not None:
        usable = (np.abs(points[:, :2]) > np.array(aperture) / 2 + margin).any(1)
    return Board(spec["kind"], points, usable, None if aperture is None else (aperture[0], aperture[1]), detector)


def detect(board: Board, grey: Grey, name: str) -> Corners:
    """Find the board's corners in a picture.

    Corners are taken as the detector refines them. It fits its window to the markers; a second refinement with a
    window of fixed size reaches over the margin of a foreshortened marker and moves corners by pixels.

    Parameters
    ----------
    board
        The target.
    grey : (y, x) uint8
        Picture, top row first.
    name
        Name of the view, for errors.

    Raises
    ------
    InputError
        The board is not in the picture, or too little of it.
    """
    ids, pixels = (_charuco if board.kind == "charuco" else _aruco)(board, np.ascontiguousarray(grey))
    known = (ids >= 0) & (ids < len(board.points))
    ids, pixels = ids[known], pixels[known]
    keep = board.usable[ids]
    ids, pixels = ids[keep], pixels[keep] + CENTRE
    if len(ids) == 0:
        raise InputError(f"{name}: the board is not found in it; check the board file, the light and the focus")
    span = np.ptp(board.points[ids, :2], axis=0) / np.ptp(board.points[board.usable, :2], axis=0)
    if len(ids) < LEAST or span.min() < SPREAD:
        raise InputError(
            f"{name}: only {len(ids)} corners of the board are found, over {100 * span.min():.0f} % of its side, but "
            f"{LEAST} over {100 * SPREAD:.0f} % are needed; show the whole board, sharp and without glare"
        )
    return Corners(name, ids, pixels)


def _charuco(board: Board, grey: Grey) -> tuple[NDArray[np.int64], Array]:
    corners, ids, _, _ = board.detector.detectBoard(grey)
    if ids is None:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    return np.asarray(ids, np.int64).ravel(), np.asarray(corners, float).reshape(-1, 2)


def _aruco(board: Board, grey: Grey) -> tuple[NDArray[np.int64], Array]:
    corners, ids, _ = board.detector.detectMarkers(grey)
    if ids is None:
        return np.zeros(0, np.int64), np.zeros((0, 2))
    markers = np.asarray(ids, np.int64).reshape(-1, 1)
    return (4 * markers + np.arange(4)).ravel(), np.asarray(corners, float).reshape(-1, 2)
