"""Types of arrays, and textures of the current variant of Mitsuba."""

from typing import Any

import drjit as dr
import mitsuba
import numpy as np
from numpy.typing import NDArray

mi: Any = mitsuba  # its types are those of the variant, at run time

Map = NDArray[np.float32]
Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def texture(values: Map, filter_mode: str = "bilinear", wrap_mode: str = "clamp") -> Any:
    """Return a texture of values (H, W, n) that is looked up exactly: without a GPU's texture units, which round."""
    filters = {"nearest": dr.FilterMode.Nearest, "bilinear": dr.FilterMode.Linear}
    wraps = {"repeat": dr.WrapMode.Repeat, "clamp": dr.WrapMode.Clamp}
    modes = {"filter_mode": filters[filter_mode], "wrap_mode": wraps[wrap_mode]}
    return mi.Texture2f(mi.TensorXf(values), use_accel=False, migrate=False, **modes)
