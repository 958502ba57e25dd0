"""Priors of a fabric's regions on the shapes of their texels, and their file."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError, read_json, write_json
from kinran.data.fabric import Fabric
from kinran.data.radiance_stack import Light
from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE, squared_widths

Array = NDArray[np.float64]

PRIOR_SD = (0.3, 0.3, 0.06, 0.3, 0.06)
"""Standard deviations (μ_x, μ_y, α, β, γ) of a texel's lobe about its region's."""
DIFFUSE_SD = 0.3
"""Standard deviation of the slopes of a texel's diffuse normal about its region's."""


@dataclass(frozen=True)
class Prior:
    """A region's prior on the shapes of its texels: F + Σ ρ_k (p_k - p̄_k)².

    It is worth one sample that sees nothing but the shapes. Many directions outvote it; as they get few, it takes
    over, up to one shape for the region.

    Attributes
    ----------
    centre : (K,) float
        Median shape of the region.
    variance
        Mean weighted squared residual of a sample about lobes of this shape.
    main
        Which lobe reflects the most: amplitude times area, of the median texel.
    lone
        Beside two Gaussian lobes: the region's prior on one of GGX, for texels whose peaks are lost.
    """

    centre: Array
    variance: float
    main: int = 0
    lone: "Prior | None" = None

    @property
    def lobes(self) -> int:
        """Number of lobes."""
        return (self.centre.size - DIFFUSE_SIZE) // LOBE_SIZE

    def stiffness(self) -> Array:
        """Weights ρ (K,)."""
        return self.variance / np.array(PRIOR_SD * self.lobes + (DIFFUSE_SD,) * DIFFUSE_SIZE) ** 2

    @property
    def narrowest(self) -> float:
        """Smallest width of its lobes (1/e, along their axes)."""
        return min(_narrowest(self.centre[LOBE_SIZE * k : LOBE_SIZE * (k + 1)]) for k in range(self.lobes))

    def scaled(self, share: float) -> "Prior":
        """The prior with a share of its weight."""
        return replace(self, variance=share * self.variance)

    def shared(self, other: "Prior") -> "Prior":
        """Prior of texels of which another region has a part: of two lobes one of each region, the other's of one."""
        k, diffuse = LOBE_SIZE * other.main, LOBE_SIZE * self.lobes
        lobes = [other.centre[k : k + LOBE_SIZE]]
        if self.lobes == 2:
            k = LOBE_SIZE * self.main
            lobes = sorted([self.centre[k : k + LOBE_SIZE], *lobes], key=lambda lobe: -lobe[2] - lobe[4])
        normal = 0.5 * (self.centre[diffuse:] + other.centre[diffuse:])
        return replace(self, centre=np.concatenate([*lobes, normal]))

    def row(self) -> dict[str, Any]:
        """The prior as its file holds it."""
        lone = None if self.lone is None else self.lone.row()
        return {"centre": self.centre.tolist(), "variance": self.variance, "main": self.main, "lone": lone}

    @classmethod
    def from_row(cls, row: dict[str, Any]) -> "Prior":
        """The prior that a file holds."""
        lone = None if row["lone"] is None else cls.from_row(row["lone"])
        return cls(np.array(row["centre"], float), float(row["variance"]), int(row["main"]), lone)


@dataclass(frozen=True)
class Priors:
    """What the fits of a fabric start from: a prior for each region, and what of its samples is trusted.

    Attributes
    ----------
    regions
        A prior for each region.
    lights : (light,) float32
        Factors of the weights of the samples of each training light.
    outliers
        Whether some samples are outliers, so that the loss is Huber's.
    """

    regions: list[Prior]
    lights: NDArray[np.float32]
    outliers: bool = False

    def write(self, path: Path, lights: list[Light]) -> None:
        """Write the priors as JSON; of the lights those that have not their full weight, by name."""
        odd = {light.name: round(float(w), 4) for light, w in zip(lights, self.lights, strict=True) if w < 1}
        trust = {"lights": odd, "outliers": self.outliers}
        write_json(path, {"regions": [prior.row() for prior in self.regions], "trust": trust})

    @classmethod
    def read(cls, path: Path, fabric: Fabric) -> "Priors":
        """Priors of a fabric, which `kinran prior` wrote.

        Raises
        ------
        InputError
            The file is missing, is something else, or is of another fabric.
        """
        value, regions = read_json(path), int(fabric.labels.max()) + 1
        try:
            names = [light.name for light in fabric.stack.lights if not light.held_out]
            weights = np.array([value["trust"]["lights"].get(name, 1) for name in names], np.float32)
            found = cls([Prior.from_row(row) for row in value["regions"]], weights, bool(value["trust"]["outliers"]))
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{path}: holds no priors ({error!r}); make it with kinran prior") from None
        if len(found.regions) < regions:
            raise InputError(
                f"{path}: holds priors of {len(found.regions)} regions, and {fabric.labels_path} has {regions}; make it"
                " again with kinran prior"
            )
        return found


def _narrowest(lobe: Array) -> float:
    """Smallest width (1/e) of a lobe (5,), along its axes."""
    xx, xy, yy = (float(w) for w in squared_widths(lobe))
    return math.sqrt(max(0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy), 1e-12))
