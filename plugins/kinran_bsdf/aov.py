"""The integrator `kinran_measured`: the distance of each pixel of a picture from the measured view.

The fabric was measured from V = N alone. Radiance towards a camera at an angle θ_v to the normal is extrapolated over
that angle, except where the light comes along N (by reciprocity, which `takeda2008` does not have).
"""

from typing import Any

import drjit as dr

from kinran_bsdf.arrays import mi

ATTRIBUTES = ("measured_distance", "label", "bound")
"""Channels of the integrator: attributes of the BSDF."""


def register() -> None:
    """Register the type `kinran_measured` with the current variant."""
    mi.register_integrator("kinran_measured", _make_class())


def _make_class() -> Any:
    class Measured(mi.SamplingIntegrator):
        """Channels after RGB: measured_distance (θ_v in radians), label, bound; −1 off the fabric."""

        def sample(
            self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True
        ) -> tuple[Any, Any, list[Any]]:
            si = scene.ray_intersect(ray, active)
            hit = active & si.is_valid()
            bsdf = si.bsdf(ray)
            values = []
            for name in ATTRIBUTES:
                known = hit & bsdf.has_attribute(name, hit)
                values.append(dr.select(known, bsdf.eval_attribute_1(name, si, known), -1))
            distance = dr.maximum(values[0], 0)
            return mi.Color3f(distance), hit, values

        def aov_names(self) -> list[str]:
            return list(ATTRIBUTES)

    return Measured
