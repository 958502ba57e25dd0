"""Priors of a fabric's regions on the shapes of their texels, and the file that holds them."""

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
"""Standard deviations (μ_x, μ_y, α, β, γ) of a texel's lobe about its region's. Choices; no command compares others."""
DIFFUSE_SD = 0.3
"""Standard deviation of the slopes of a texel's diffuse normal about its region's. A choice, as above."""


@dataclass(frozen=True)
class Prior:
    """A region's prior on the shapes of its texels, which adds Σ ρ_k (p_k - p̄_k)² to the cost of a fit.

    It weighs as much as one sample that sees the shapes alone. Many directions outvote it; the fewer they are, the more
    it decides, up to one shape for the region.

    Attributes
    ----------
    centre : (K,) float
        Median shape of the region.
    variance
        Mean weighted squared residual of a sample about lobes of this shape.
    main
        Index of the lobe that reflects the most (amplitude times area) in the median texel.
    lone
        Prior on one GGX lobe, beside a prior on two Gaussian lobes, for texels whose peaks are lost; otherwise None.
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
        """Weights ρ (K,) of the squared deviations from the centre."""
        return self.variance / np.array(PRIOR_SD * self.lobes + (DIFFUSE_SD,) * DIFFUSE_SIZE) ** 2

    @property
    def narrowest(self) -> float:
        """Smallest width of its lobes (1/e, along their axes)."""
        return min(_narrowest(self.centre[LOBE_SIZE * k : LOBE_SIZE * (k + 1)]) for k in range(self.lobes))

    def scaled(self, share: float) -> "Prior":
        """The prior with this share of its weight."""
        return replace(self, variance=share * self.variance)

    def shared(self, other: "Prior") -> "Prior":
        """Prior of texels that this region shares with another.

        Two lobes are the main lobes of the two regions; one lobe is the main lobe of the other region.
        """
        k, diffuse = LOBE_SIZE * other.main, LOBE_SIZE * self.lobes
        lobes = [other.centre[k : k + LOBE_SIZE]]
        if self.lobes == 2:
            k = LOBE_SIZE * self.main
            lobes = sorted([self.centre[k : k + LOBE_SIZE], *lobes], key=lambda lobe: -lobe[2] - lobe[4])
        normal = 0.5 * (self.centre[diffuse:] + other.centre[diffuse:])
        return replace(self, centre=np.concatenate([*lobes, normal]))

    def row(self) -> dict[str, Any]:
        """The prior as a JSON value."""
        lone = None if self.lone is None else self.lone.row()
        return {"centre": self.centre.tolist(), "variance": self.variance, "main": self.main, "lone": lone}

    @classmethod
    def from_row(cls, row: dict[str, Any]) -> "Prior":
        """The prior that a JSON value holds."""
        lone = None if row["lone"] is None else cls.from_row(row["lone"])
        return cls(np.array(row["centre"], float), float(row["variance"]), int(row["main"]), lone)


@dataclass(frozen=True)
class Priors:
    """Priors of a fabric's regions, and the trust in its samples.

    Attributes
    ----------
    regions
        A prior for each region.
    lights : (light,) float32
        Factor of the weights of each training light's samples.
    outliers
        Whether some samples are outliers, so that fits take robust weights.
    """

    regions: list[Prior]
    lights: NDArray[np.float32]
    outliers: bool = False

    def write(self, path: Path, lights: list[Light]) -> None:
        """Write the priors as JSON, with the names and factors of the lights that do not have full weight."""
        odd = {light.name: round(float(w), 4) for light, w in zip(lights, self.lights, strict=True) if w < 1}
        trust = {"lights": odd, "outliers": self.outliers}
        write_json(path, {"regions": [prior.row() for prior in self.regions], "trust": trust})

    @classmethod
    def read(cls, path: Path, fabric: Fabric) -> "Priors":
        """Read the priors of a fabric, which `kinran prior` wrote.

        Raises
        ------
        InputError
            The file is missing, holds no priors, or holds them for fewer regions than the fabric has.
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
