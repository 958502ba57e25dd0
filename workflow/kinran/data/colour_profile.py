"""ICC profiles that photographs embed: from a picture's codes to linear Rec. 709, by LittleCMS."""

import functools
import io

import imagecodecs
import numpy as np
from numpy.typing import NDArray
from PIL import ImageCms

from kinran.base.encoding import from_srgb

REC709 = {"whitepoint": [0.3127, 0.3290, 1.0], "primaries": [0.64, 0.33, 1.0, 0.30, 0.60, 1.0, 0.15, 0.06, 1.0]}
"""White (D65) and primaries of Rec. 709 as x, y, Y (ITU-R BT.709)."""
STEPS = 9
"""Levels of R, G and B at which a profile is compared with sRGB."""
SAME = 0.004
"""Largest difference of linear light up to which a profile is taken for sRGB: one code of 8 bits at white."""


def to_linear(codes: NDArray[np.float32], profile: bytes) -> NDArray[np.float32]:
    """Return linear Rec. 709 (..., 3) of codes (..., 3) under a profile; colours out of gamut have negative parts."""
    rows = np.ascontiguousarray(codes, np.float32).reshape(1, -1, 3)
    target = imagecodecs.cms_profile("rgb", gamma=1.0, **REC709)
    linear = imagecodecs.cms_transform(rows, profile, target, colorspace="rgb", outcolorspace="rgb", outdtype="float32")
    return np.asarray(linear, np.float32).reshape(codes.shape)


@functools.lru_cache(maxsize=64)
def is_srgb(profile: bytes) -> bool:
    """Return whether a profile is sRGB, as far as pictures can tell."""
    levels = np.linspace(0, 1, STEPS, dtype=np.float32)
    codes = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), -1)
    return bool(np.abs(to_linear(codes, profile) - from_srgb(codes)).max() <= SAME)


def name_of(profile: bytes) -> str:
    """Return the name that a profile gives itself."""
    described = ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))
    return " ".join(described.split()) or "without a name"
