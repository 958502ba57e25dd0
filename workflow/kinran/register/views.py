"""A session of views, from photographs to files."""

import logging
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.base.exr import write_exr
from kinran.base.files import InputError, write_json
from kinran.data import photographs
from kinran.register.cameras import Cameras, JudgedCameras, calibrate, describe
from kinran.register.height import Surface, measure
from kinran.register.rectify import FLOOR, Grid, Image, check_inside, grid_of, rectify, shifts
from kinran.register.target import Board, detect, read_board

log = logging.getLogger(__name__)

LIMIT = 0.05
"""Median shift to the front view, in mm, up to which a view counts as registered. A choice: a twentieth of a gold strip
of 1 mm."""
HELD = 0.5
"""Share of the patches that must have a texture in common with the front view's: with less, the median is that of a
part of the field. No measurement stands behind the share."""
ODD = 3.0
"""Multiple of the median of the views' reprojection errors above which one is worth a warning. No measurement stands
behind it."""
FRAME = "X=+u=weft, Y=+v=warp, Z=view; mm from the middle of the board; "

Array = NDArray[np.float64]


def register(out: Path, views: list[Path], board_file: Path, field: str, encoded: str) -> None:
    """Register the views of a fabric and write all results.

    Parameters
    ----------
    out
        Folder for ``cameras.json``, ``height.exr`` (row 0 is v = 0), ``rectified/<view>.exr`` (linear light; pictures,
        so the top row is the first) and ``register.json``, which is written last.
    views
        Photographs of one size; the front view first.
    board_file
        Description of the target.
    field
        ``W,H`` in mm; empty for 90 % of the opening.
    encoded
        Encoding of the photographs.

    Raises
    ------
    InputError
        A picture, the board or the field cannot be used; nothing is written then.
    """
    decoder = encoding.parse(encoded)
    board = read_board(board_file)
    size_mm = field_of(field, board, board_file)
    width, height = check_views(views)
    greys = [grey(photographs.read(path, decoder).value[::-1]) for path in views]
    corners = [
        detect(board, np.round(255 * picture).astype(np.uint8), str(path))
        for path, picture in zip(views, greys, strict=True)
    ]
    calibration = calibrate(board.points, corners, width, height)
    cameras = calibration.cameras
    grid = grid_of(cameras, size_mm)
    check_inside(cameras, grid)
    surface = measure(cameras, greys, grid)
    report = judge(calibration, greys, grid, surface, [path.stem for path in views])

    described = describe(calibration)
    for view, path in zip(described["views"], views, strict=True):
        view["name"] = path.stem
    write_json(out / "cameras.json", described)
    header: dict[str, object] = {"kinran:texel_mm": f"{grid.texel:.9g}"}
    write_exr(
        out / "height.exr",
        {"height": surface.height.astype(np.float32)},
        {**header, "kinran:frame": FRAME + "row 0 is v=0", "kinran:units": "mm"},
    )
    for view, path in enumerate(views):
        light = np.ascontiguousarray(photographs.read(path, decoder).value[::-1])
        flat = rectify(cameras, view, light, grid, surface.height)[::-1]
        write_exr(
            out / "rectified" / f"{path.stem}.exr",
            {name: flat[..., k] for k, name in enumerate("RGB")},
            {**header, "kinran:frame": FRAME + "the last row is v=0"},
        )
    write_json(out / "register.json", report)
    show(report)


def field_of(text: str, board: Board, board_file: Path) -> tuple[float, float]:
    """Width and height of the field in mm, from ``W,H`` or from the opening.

    Raises
    ------
    InputError
        The text is no size, the field is larger than the opening, or neither is given.
    """
    if not text:
        if board.aperture is None:
            raise InputError(f"{board_file}: has no aperture_mm; add it, or give --field-mm")
        return 0.9 * board.aperture[0], 0.9 * board.aperture[1]
    try:
        width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"field '{text}': give W,H in mm, such as 45,45") from None
    largest = board.aperture or tuple(np.ptp(board.points[:, :2], axis=0))
    if not (0 < width <= largest[0] and 0 < height <= largest[1]):
        raise InputError(f"field '{text}': must be inside the opening of {largest[0]:g} x {largest[1]:g} mm")
    return width, height


def check_views(views: list[Path]) -> tuple[int, int]:
    """Width and height that all views have.

    Raises
    ------
    InputError
        A view cannot be read, two have one name, or their sizes differ.
    """
    named: dict[str, Path] = {}
    for path in views:
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if path.stem in named:
            raise InputError(f"{path}: has the same name as {named[path.stem]}; rename one")
        named[path.stem] = path
    sizes = [photographs.size(path) for path in views]
    for path, size in zip(views, sizes, strict=True):
        if size != sizes[0]:
            raise InputError(
                f"{path}: is {size[0]}x{size[1]}, but {views[0]} is {sizes[0][0]}x{sizes[0][1]}; "
                "give all views as the one camera took them, uncropped"
            )
    return sizes[0]


def grey(light: Image) -> Image:
    """Grey in [0, 1], evenly spaced to the eye, of linear light (y, x, 3) with any white."""
    level = light.mean(-1)
    white = max(float(np.percentile(level, 99.5)), 1e-9)
    return np.ascontiguousarray(encoding.parse("srgb").encode(level / white))


def judge(
    calibration: JudgedCameras, greys: list[Image], grid: Grid, surface: Surface, names: list[str]
) -> dict[str, Any]:
    """Contents of `register.json`: the shift of each view to the front view, through the height and on the plane."""
    cameras = calibration.cameras
    floor = FLOOR * cameras.pixel_mm(0)
    direction = cameras.centres / np.linalg.norm(cameras.centres, axis=1, keepdims=True)
    views, warnings = [], []
    for view, name in enumerate(names):
        row: dict[str, Any] = {
            "name": name,
            "theta": float(np.arccos(direction[view, 2])),
            "rms_px": float(calibration.rms[view]),
        }
        if view > 0:
            row |= _shift(cameras, view, greys, grid, surface.height, "")
            row |= _shift(cameras, view, greys, grid, np.zeros_like(surface.height), "plane_")
            held = row["patches"] >= HELD * row["patches_tried"]
            row["registered"] = held and row["median_mm"] <= LIMIT
            if not held:
                warnings.append(f"{name}: is not registered; it has too little texture in common with the front view")
            elif not row["registered"]:
                off = f"{row['median_mm']:.3f} mm off the front view"
                warnings.append(f"{name}: is not registered; it is {off}, and {LIMIT} mm are allowed")
        if row["rms_px"] > ODD * float(np.median(calibration.rms)):
            warnings.append(f"{name}: its corners fit {row['rms_px']:.2f} px, much worse than the other views'")
        views.append(row)
    if floor > LIMIT:
        warnings.append(f"the measure's floor of {floor:.3f} mm is above {LIMIT} mm: a finer camera is needed to tell")
    return {
        "field_mm": [grid.width * grid.texel, grid.height * grid.texel],
        "texel_mm": grid.texel,
        "floor_mm": floor,
        "limit_mm": LIMIT,
        "height": {
            "points": len(surface.residual),
            "views_a_point": float(surface.points.views.mean()),
            "residual_mm": 1.4826 * float(np.median(np.abs(surface.residual))),
            "range_mm": [float(surface.height.min()), float(surface.height.max())],
        },
        "views": views,
        "registered": all(row.get("registered", True) for row in views),
        "warnings": warnings,
    }


def _shift(
    cameras: Cameras, view: int, greys: list[Image], grid: Grid, height: Array, prefix: str
) -> dict[str, float | int | None]:
    pair = [rectify(cameras, k, greys[k], grid, height) for k in (0, view)]
    every = shifts(pair[0], pair[1], grid.texel)
    found = every[np.isfinite(every)]
    return {
        f"{prefix}patches": len(found),
        f"{prefix}median_mm": float(np.median(found)) if len(found) else None,
        f"{prefix}p95_mm": float(np.percentile(found, 95)) if len(found) else None,
        "patches_tried": len(every),
    }


def show(report: dict[str, Any]) -> None:
    """Print the shift of each view, and log the warnings."""
    print(f"shift to the front view in mm (the measure's floor is {report['floor_mm']:.3f}):")
    for row in report["views"][1:]:
        numbers = [row[f"{kind}{number}_mm"] for kind in ("", "plane_") for number in ("median", "p95")]
        median, p95, plane, plane_p95 = ("   -" if n is None else f"{n:.3f}" for n in numbers)
        degrees = f"{np.degrees(row['theta']):.0f}°"
        print(f"  {row['name']:16} {degrees:>4}  median {median}  p95 {p95}   (plane: {plane}, {plane_p95})")
    for warning in report["warnings"]:
        log.warning("warning: %s", warning)
