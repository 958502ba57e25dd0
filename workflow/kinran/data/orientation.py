"""How a picture is shown: the eight orientations that a camera may write beside its samples."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

UPRIGHT = 1
"""Orientation of a picture that is shown as it is stored (EXIF 2.32, tag 274)."""
STEPS = {
    1: (False, False, False),
    2: (False, False, True),
    3: (False, True, True),
    4: (False, True, False),
    5: (True, False, False),
    6: (True, False, True),
    7: (True, True, True),
    8: (True, True, False),
}
"""Of each orientation: whether rows and columns change places, and whether then rows and columns run backwards."""
OF_LIBRAW = {0: 1, 1: 2, 3: 3, 2: 4, 4: 5, 6: 6, 7: 7, 5: 8}
"""Orientation of each of LibRaw's codes, whose bits are columns backwards, rows backwards, and change of places."""


def upright(stored: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return a picture (y, x, ...), the top row first, as it is shown; a view of what is stored."""
    turned, rows, columns = STEPS.get(orientation, STEPS[UPRIGHT])
    shown = np.swapaxes(stored, 0, 1) if turned else stored
    return shown[:: -1 if rows else 1, :: -1 if columns else 1]


def shown_size(width: int, height: int, orientation: int) -> tuple[int, int]:
    """Return width and height of a picture as it is shown."""
    return (height, width) if STEPS.get(orientation, STEPS[UPRIGHT])[0] else (width, height)
