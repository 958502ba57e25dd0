"""Pictures of a material's maps."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import pictures
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material


def maps(material: Material) -> Iterator[tuple[str, pictures.Picture]]:
    """Caption and upright picture of each map."""
    channels = material.channels
    yield "Diffuse colour C_d", _colour(material, "diffuse")
    for k in range(1, material.lobes + 1):
        lobe = f"lobe{k}"
        which = "the lobe" if material.lobes == 1 else f"lobe {k}"
        yield f"Colour C_s of {which}", _colour(material, lobe)
        if f"{lobe}.x" in channels:
            slope = pictures.directions_map(channels[f"{lobe}.x"], channels[f"{lobe}.y"])
            yield f"Slope of the facets of {which}: hue is its direction (red: +weft), full at 0.6", slope
            wide, narrow = _widths(*(channels[f"{lobe}.{name}"] for name in ("xx", "xy", "yy")))
            yield f"Width of {which} along its long axis, to 0.6", pictures.heat(wide, 0.6)
            yield f"Width of {which} along its short axis, to 0.6", pictures.heat(narrow, 0.6)
    if "lobe1.theta" in channels:
        tangent, phi = np.tan(np.clip(channels["lobe1.theta"], 0, 1.2)), channels["lobe1.phi"]
        azimuth = pictures.directions_map(tangent * np.cos(phi), tangent * np.sin(phi))
        yield "Normal of Eq. 3: hue is its azimuth", azimuth
        yield "dt, to 0.6 rad", pictures.heat(channels["lobe1.dt"], 0.6)
        yield "dp, to π", pictures.heat(channels["lobe1.dp"], math.pi)
    if (channels["bound"] < 1).any():
        yield "Where the albedo bound clamps (pale: by half)", pictures.heat(1 - channels["bound"], 0.5)


def rec709(acescg: NDArray[Any]) -> NDArray[np.float32]:
    """Linear ACEScg (…, 3) as linear Rec. 709."""
    return np.asarray(acescg @ TO_REC709.T, np.float32)


def _colour(material: Material, part: str) -> pictures.Picture:
    """Picture of one term's colour, relative to a white diffuser, at an exposure of its own."""
    colour = np.stack([material.channels[f"{part}.{c}"] for c in "RGB"], -1)
    light = rec709(np.pi * material.channels[f"{part}.amplitude"][..., None] * colour)
    return pictures.photograph(light, pictures.auto_exposure(light))


def _widths(
    xx: NDArray[np.float32], xy: NDArray[np.float32], yy: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Long and short half axes (y, x) of the ellipses of 2 × 2 covariances."""
    middle, spread = (xx + yy) / 2, np.hypot((xx - yy) / 2, xy)
    return np.sqrt(middle + spread), np.sqrt(np.maximum(middle - spread, 0))
