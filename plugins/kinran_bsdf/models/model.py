"""The interface of a reflection model to the fit, the relighting and the renderer.

Directions are triples of NumPy or of Dr.Jit arrays in the frame of the fabric: X weft, Y warp, Z normal.
"""

from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from kinran_bsdf.arrays import Map, Mask

GRAZING = float(np.cos(np.radians(85.0)))
"""Cosine from which T fades to the horizon: that of 85°, a step beyond the paper's grid of lights (Takeda2008, §4)."""
WIDTH_FLOOR = 1e-3
"""Least width of a lobe, in radians or as a slope; its square is the least squared width. A choice: 1/20 of the
narrowest lobe that a fit allows."""


class Model:
    """A model of the lobes of a texel; the diffuse term is the same in all models (`lambert`).

    A lobe is 1 at its centre, and its `shape` is the sequence of its parameters. Methods with the parameter `xp`, the
    module of their mathematics (``numpy`` or ``drjit``), take arrays of both. Views and lights are triples of unit
    vectors' components.

    Attributes
    ----------
    name
        Name of the model in files and scenes.
    parameters
        Channels of a lobe's shape in their order, with their default values.
    counts
        Numbers of lobes that a material can have.
    filtered
        Whether shapes may be averaged between texels. If so, they are x, y, xx, xy, yy: mean and squared widths in
        slopes, which `mixture` reduces for the pyramid.
    lobes
        Number of lobes.
    """

    name: ClassVar[str]
    parameters: ClassVar[dict[str, float]]
    counts: ClassVar[tuple[int, ...]]
    filtered: ClassVar[bool]
    lobes: int

    @classmethod
    def of(cls, tail: str, lobes: int) -> "Model":
        """Return the model with the tail and lobes of a material's header; a model without tails ignores them."""
        return cls()

    @property
    def terms(self) -> dict[str, dict[str, float]]:
        """Parameters of the diffuse term, then of each lobe, by the name of the term."""
        return {"diffuse": {"x": 0.0, "y": 0.0}} | {f"lobe{k + 1}": self.parameters for k in range(self.lobes)}

    def value(self, view: Any, light: Any, shape: Any, *, xp: ModuleType = np) -> Any:
        """Return the lobe G(h) as it was fitted: T / (amplitude · colour) near the measured view V = N."""
        raise NotImplementedError

    def lobe(self, view: Any, light: Any, shape: Any, floor: Any, *, xp: ModuleType = np) -> Any:
        """Return the lobe for any view, T / (amplitude · colour); it fades below `floor`, the lowest light's cosine."""
        return self.value(view, light, shape, xp=xp)

    def albedo(self, shape: Any, *, xp: ModuleType = np) -> Any:
        """Return the approximate albedo at V = N of a lobe of amplitude 1, in closed form."""
        raise NotImplementedError

    def integral(self, shape: Map, nodes: int) -> Map:
        """Return the albedo (…) of `albedo` by quadrature with `nodes` nodes per dimension; shape (n, …)."""
        raise NotImplementedError

    @property
    def spread(self) -> int:
        """Squared width of a lobe whose slopes have the variance 1, by its curvature at the centre."""
        raise NotImplementedError

    def without_width(self, shape: Any) -> Mask:
        """Return which lobes (…) have no positive width; shape (n, …)."""
        raise NotImplementedError

    def floor_widths(self, shape: Map) -> None:
        """Raise the widths of lobes (…, n) to at least `WIDTH_FLOOR`, in place."""
        raise NotImplementedError

    def confined(self, shape: list[Any]) -> list[Any]:
        """Return the shape of a lobe, moved into the range that can be rendered (Dr.Jit)."""
        raise NotImplementedError

    def sample(self, shape: list[Any], u: Any) -> Any:
        """Return a half vector drawn from a lobe with two uniform numbers `u` (Dr.Jit)."""
        raise NotImplementedError

    def density(self, shape: list[Any], view: Any, light: Any) -> Any:
        """Return the density in solid angle of the light that `sample` gives for `view`: p(h) / (4 v·h) (Dr.Jit)."""
        raise NotImplementedError


def release(view: Any, light: Any, *, xp: ModuleType = np) -> Any:
    """Return the weight of the measured view, max(cos θ_v, cos θ_l)⁸.

    It is 1 where view or light is N, 0.32 at 30°, and 0.004 at 60°. The exponent is a choice.
    """
    c = xp.maximum(view[2], light[2])
    c = c * c
    c = c * c
    return c * c


def grazing(theta_max: float) -> float:
    """Return the cosine from which T fades to the horizon: of 85°, or of the largest measured θ (radians) if larger."""
    return float(min(GRAZING, max(np.cos(theta_max), 1e-3)))
