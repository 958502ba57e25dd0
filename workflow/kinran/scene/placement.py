"""Placement of a material on a cloth: the extent of the mesh, and the defaults of a scene that place the maps."""

from pathlib import Path

import mitsuba as mi
import numpy as np

from kinran.base.files import InputError, check_comment


def uv_size(mesh: Path) -> tuple[float, float]:
    """Extent in u and v, in mm, of a mesh's texture coordinates, which start at (0, 0).

    Raises
    ------
    InputError
        The mesh is missing, unreadable, does not match its checksum, or has no texture coordinates; without them a
        weave has no direction.
    """
    if not mesh.is_file():
        raise InputError(f"{mesh}: no such file; make it with kinran mesh")
    check_comment(mesh)
    if mi.variant() is None:
        mi.set_variant("scalar_rgb")
    try:
        shape = mi.load_dict({"type": "ply", "filename": str(mesh)})
    except Exception as error:  # Mitsuba raises bare RuntimeError
        raise InputError(f"{mesh}: Mitsuba cannot read it ({error}); make it with kinran mesh") from None
    if not shape.has_vertex_texcoords():
        raise InputError(f"{mesh}: has no texture coordinates; make it with kinran mesh")
    uv = np.array(mi.traverse(shape)["vertex_texcoords"]).reshape(-1, 2)
    width, height = uv.max(0)
    return float(width), float(height)


def placement(shape: tuple[int, int], texel_mm: float | None, cloth: tuple[float, float]) -> dict[str, str]:
    """Place a material on the cloth: values of the template's `repeat_*`, `shift_*` and `wrap`.

    Parameters
    ----------
    shape
        Rows and columns of the maps.
    texel_mm
        Side of a texel in mm; None if unknown.
    cloth
        Extent of the cloth in mm along weft and warp.

    Returns
    -------
    dict
        Values by name. A swatch of known size repeats. One of unknown size covers the width of the cloth once, with its
        top at the top, and starts again below, so that the whole picture is seen.
    """
    rows, columns = shape
    if texel_mm is not None:
        size, shift = np.array([columns, rows]) * texel_mm, np.zeros(2)
    else:
        size = np.array([columns, rows]) * cloth[0] / columns
        shift = np.array([0.0, size[1] - cloth[1]])
    values = {"repeat_x": 1 / size[0], "repeat_y": 1 / size[1], "shift_x": shift[0], "shift_y": shift[1]}
    return {**{name: f"{value:.9g}" for name, value in values.items()}, "wrap": "repeat"}
