"""What a reflection model is: all that the fit, the relighting and the renderer ask of one.

Directions are triples of NumPy or of Dr.Jit arrays in the frame of the fabric: X weft, Y warp, Z normal.
"""

from types import ModuleType
from typing import Any, ClassVar

import numpy as np

from kinran_bsdf.arrays import Map, Mask

GRAZING = float(np.cos(np.radians(85.0)))
"""Cosine from which T fades to the horizon: the paper's grid of lights ends at 80°."""
WIDTH_FLOOR = 1e-3  # radians, or slope at N; its square is the floor of a variance


class Model:
    """A model of the lobes of a texel; the diffuse term is the same in all of them (`lambert`).

    A lobe is 1 at its centre, and its `shape` is the sequence of its parameters. What has the parameter `xp`, the
    module of its mathematics (``numpy`` or ``drjit``), takes NumPy and Dr.Jit arrays alike. Views and lights are
    triples.

    Attributes
    ----------
    name
        As files and scenes have it.
    parameters
        Channels of a lobe's shape, in their order, and the values that they have where nobody gives any.
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
        """The model as the header of a material describes it; a model without a tail ignores it."""
        return cls()

    @property
    def terms(self) -> dict[str, dict[str, float]]:
        """Parameters of the diffuse term, then of each lobe, by the name of the term."""
        return {"diffuse": {"x": 0.0, "y": 0.0}} | {f"lobe{k + 1}": self.parameters for k in range(self.lobes)}

    def value(self, view: Any, light: Any, shape: Any, *, xp: ModuleType = np) -> Any:
        """Lobe G(h) as it was fitted: T / (amplitude · colour) near the measured view V = N."""
        raise NotImplementedError

    def lobe(self, view: Any, light: Any, shape: Any, floor: Any, *, xp: ModuleType = np) -> Any:
        """Lobe for any view: T / (amplitude · colour), which fades below the cosine `floor` of the lowest light."""
        return self.value(view, light, shape, xp=xp)

    def albedo(self, shape: Any, *, xp: ModuleType = np) -> Any:
        """Albedo at V = N of a lobe of amplitude 1, nearly, in closed form."""
        raise NotImplementedError

    def integral(self, shape: Map, nodes: int) -> Map:
        """The same by quadrature with `nodes` nodes a dimension; shape (n, …)."""
        raise NotImplementedError

    @property
    def spread(self) -> int:
        """Squared width of a lobe whose slopes have the variance 1, judged by how it falls at its centre."""
        raise NotImplementedError

    def without_width(self, shape: Any) -> Mask:
        """Which lobes are none, as they have no positive width."""
        raise NotImplementedError

    def floor_widths(self, shape: Map) -> None:
        """Raise the widths of lobes (…, n) to `WIDTH_FLOOR` where they are smaller, in place."""
        raise NotImplementedError

    def confined(self, shape: list[Any]) -> list[Any]:
        """Shape of a lobe that can be rendered, whatever textures say (Dr.Jit)."""
        raise NotImplementedError

    def sample(self, shape: list[Any], u: Any) -> Any:
        """Half vector drawn from a lobe with two uniform numbers `u` (Dr.Jit)."""
        raise NotImplementedError

    def density(self, shape: list[Any], view: Any, light: Any) -> Any:
        """Density in solid angle of the light that `sample` leads to from `view`: p(h) / (4 v·h) (Dr.Jit)."""
        raise NotImplementedError


def release(view: Any, light: Any, *, xp: ModuleType = np) -> Any:
    """1 where view or light is N, falling to 0.32 at 30° and 0.004 at 60°: how far data speak there."""
    c = xp.maximum(view[2], light[2])
    c = c * c
    c = c * c
    return c * c


def grazing(theta_max: float) -> float:
    """Cosine from which T fades to the horizon: of 85°, or of the lowest measured light if that is lower."""
    return float(min(GRAZING, max(np.cos(theta_max), 1e-3)))
