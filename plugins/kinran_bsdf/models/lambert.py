"""The diffuse term, which each model has, and the model that has nothing else."""

from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from kinran_bsdf.models.model import Model, release


class Lambert(Model):
    """The diffuse term alone, for cloth that needs no lobe."""

    name = "lambert"
    parameters: ClassVar = {}
    counts = (0,)
    filtered = True
    lobes = 0


def diffuse(light: Any, x: Any, y: Any, *, xp: ModuleType = np) -> Any:
    """Return the diffuse factor at V = N of a Lambertian facet of slopes (x, y): max(0, l_z + x l_x + y l_y)."""
    lx, ly, lz = light
    return xp.maximum(lz + x * lx + y * ly, 0.0)


def diffuse_lift(view: Any, light: Any, x: Any, y: Any, floor: Any, *, xp: ModuleType = np) -> Any:
    """Return the diffuse factor for any view, T / (amplitude · colour), which is `diffuse` at V = N.

    It is r(v) r(l) l_z with r(w) = 1 + (x w_x + y w_y) / w_z, the projected area of a facet of slopes (x, y) over that
    of the fabric, which is exact for facets that do not shadow each other. V-cavity masking, released towards the
    measured view, limits r to [0, 2]. The BRDF r(v) r(l) is symmetric in v and l.
    """
    cap = 2 / xp.maximum(1 - release(view, light, xp=xp), 1e-4)

    def area(w: Any) -> Any:
        r = 1 + (x * w[0] + y * w[1]) / xp.maximum(w[2], floor)
        return xp.minimum(xp.maximum(r, 0.0), cap)

    return area(view) * area(light) * light[2]


def diffuse_albedo(x: Any, y: Any, *, xp: ModuleType = np) -> Any:
    """Return the albedo of the diffuse factor: ∫ max(0, l_z + x l_x + y l_y) dω = π (1 + √(1 + x² + y²)) / 2."""
    return 0.5 * np.pi * (1 + xp.sqrt(1 + x * x + y * y))
