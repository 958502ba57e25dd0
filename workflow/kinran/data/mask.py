"""The mask of a set of photographs: which texels hold the thing that is measured."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.data.photographs import MASK, Crop, is_picture, size
from kinran.data.picture_file import read_picture


def find_mask(folder: Path) -> Path | None:
    """Return the mask that lies beside photographs; None where none does.

    Raises
    ------
    InputError
        There are several, and none is named ``mask`` alone.
    """
    found = [path for path in sorted(folder.glob("*")) if MASK.fullmatch(path.stem) and is_picture(path)]
    plain = [path for path in found if path.stem.casefold() == "mask"] or found
    if len(plain) > 1:
        raise InputError(f"{folder}: has {plain[0].name} and {plain[1].name}; give the right one by --mask FILE")
    return plain[0] if plain else None


def read_mask(path: Path, whole: tuple[int, int], crop: Crop | None = None) -> NDArray[np.bool_]:
    """Read which texels are inside (y, x), row 0 at the bottom: those over half of white in any channel.

    Parameters
    ----------
    path
        Picture of the mask.
    whole
        Width and height of a whole photograph.
    crop
        Part of it that is used.

    Raises
    ------
    InputError
        It cannot be read, is of another size than the photographs, or leaves nothing.
    """
    if size(path) != whole:
        raise InputError(
            f"{path}: the mask is {'x'.join(map(str, size(path)))} but the photographs are {'x'.join(map(str, whole))};"
            " give one of their size"
        )
    picture = read_picture(path)
    inside = picture.values.max(-1) > 0.5 * (picture.ceiling or 1)
    if crop:
        inside = inside[crop.y : crop.y + crop.height, crop.x : crop.x + crop.width]
    if not inside.any():
        raise InputError(f"{path}: the mask leaves no texel; white is what is kept")
    return np.asarray(inside[::-1])
