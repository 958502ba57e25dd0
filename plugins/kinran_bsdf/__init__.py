"""Mitsuba 3 BSDF of measured, spatially varying fabric.

Importing this package registers the BSDF `kinran` and the integrator `kinran_measured` for the current and
every later variant.
"""

import mitsuba as mi

from kinran_bsdf import aov, bsdf
from kinran_bsdf.bsdf import shared_maps
from kinran_bsdf.material import Material, read_material, write_material

__all__ = ["Material", "read_material", "shared_maps", "write_material"]


def _register(old: str | None, new: str | None) -> None:
    if new is not None and old != new:
        bsdf.register()
        aov.register()


_register(None, mi.variant())
mi.detail.add_variant_callback(_register)
