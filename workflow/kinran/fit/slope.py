"""The `slope` model fitted to a block of texels: bounds, weights, starts, threads."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinran import frames
from kinran.files import read_json, write_json
from kinran.fit import fused
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, squared_widths
from kinran.fit.rows import LANES

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

ITERATIONS = 12
TOLERANCE = 3e-4
"""Share of the cost that a step has to promise, and to gain, for the search to go on."""
BLOCK = 256
"""Texels of a job of a thread."""
MAX_WIDTH = 2.0
NARROWEST = 0.02
"""Smallest width allowed."""
SCOUTS = 2
"""Iterations, at most, of the lone GGX lobe that two lobes start from."""
NEEDLE = {1: 0.5, 2: 0.6}
"""Share of the distance of two lights below which a lobe is a needle between them."""
PRIOR_SD = (0.3, 0.3, 0.06, 0.3, 0.06)
DIFFUSE_SD = 0.3
FEW = 150
"""With fewer lights a lobe may stand between them: a second start is tried, at the brightest sample; and priors have
a say: a second one is tried at texels that two regions share."""


@dataclass(frozen=True)
class SlopeFit:
    """Result for a block of texels.

    Attributes
    ----------
    shapes : (texel, K) float64
        (μ_x, μ_y, α, β, γ) a lobe, the narrower lobe first, then the slopes of the diffuse normal.
    colours : (texel, lobes + 1, 3) float64
        Amplitudes of the lobes and of the diffuse term, in the unit of the samples.
    cost : (texel,) float64
        Weighted squared residual.
    """

    shapes: Array
    colours: Array
    cost: Array

    def part(self, at: NDArray[np.intp]) -> "SlopeFit":
        """The fit of some texels."""
        return SlopeFit(self.shapes[at], self.colours[at], self.cost[at])

    def put(self, at: NDArray[np.intp], part: "SlopeFit") -> None:
        """Take the fit of some texels from another."""
        self.shapes[at], self.colours[at], self.cost[at] = part.shapes, part.colours, part.cost


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

    def narrow(self, resolved: float) -> float:
        """Smallest width of a lobe: what one texel resolves, or the region's if all of it show it to be smaller."""
        widths = [_narrowest(self.centre[LOBE_SIZE * k : LOBE_SIZE * (k + 1)]) for k in range(self.lobes)]
        return min(resolved, *widths)

    def shared(self, other: "Prior") -> "Prior":
        """Prior of texels of which another region has a part: of two lobes one of each region, the other's of one."""
        k, diffuse = LOBE_SIZE * other.main, LOBE_SIZE * self.lobes
        lobes = [other.centre[k : k + LOBE_SIZE]]
        if self.lobes == 2:
            k = LOBE_SIZE * self.main
            lobes = sorted([self.centre[k : k + LOBE_SIZE], *lobes], key=lambda lobe: -lobe[2] - lobe[4])
        normal = 0.5 * (self.centre[diffuse:] + other.centre[diffuse:])
        return replace(self, centre=np.concatenate([*lobes, normal]))


def write_priors(path: Path, priors: list[Prior], trust: dict[str, Any] | None = None) -> None:
    """Write the priors of the regions as JSON, with what is not to be trusted (`kinran.fit.trust`)."""
    trust = {"lights": {}, "outliers": False} if trust is None else trust
    write_json(path, {"regions": [_row(prior) for prior in priors], "trust": trust})


def read_priors(path: Path) -> list[Prior]:
    """Priors of the regions, as the stage `prior` writes them."""
    return [_prior(row) for row in read_json(path)["regions"]]


def resolution(lights: Array, lobes: int = 1) -> float:
    """Smallest lobe width (1/e, in slopes) that light directions (n, 3) can tell from a needle between two.

    It is half of the median distance to the nearest other light in slope space, more for two lobes, and at least
    `NARROWEST`.
    """
    s = frames.slopes(lights)
    if len(s) < 2:
        return MAX_WIDTH / 2
    nearest = cKDTree(s).query(s, 2)[0][:, 1]
    return float(np.clip(NEEDLE[lobes] * np.median(nearest), NARROWEST, MAX_WIDTH / 2))


def fit(
    T: Samples,
    W: Samples,
    lights: Array,
    tail: str = "ggx",
    lobes: int = 1,
    priors: list[Prior] | None = None,
    region: NDArray[np.intp] | None = None,
    threads: int = 1,
    bent: bool = True,
    iterations: int = ITERATIONS,
    start: Array | None = None,
    narrow: float | None = None,
    slopes: Array | None = None,
    second: NDArray[np.intp] | None = None,
) -> SlopeFit:
    """Fit lobes in slope space and a diffuse term to each texel.

    Parameters
    ----------
    T : (texel, 3, light) float32
        Radiance samples (T of DESIGN: f_r cos θ_i, in any unit).
    W : (texel, light) float32
        Sample weights; 0 for what is not to be used. Samples that are not finite get 0.
    lights : (light, 3) float
        Unit directions.
    tail
        ``gaussian`` or ``ggx``.
    lobes
        One or two.
    priors, region
        A prior for each region and the region (texel,) of each texel; without them every texel stands alone.
    threads
        Of the machine; the result does not depend on it.
    bent
        Whether the diffuse term has a normal of its own; otherwise it is N.
    iterations
        At most.
    start : (texel, K)
        Shapes to start from; by default from the moments of the highlight.
    narrow
        Smallest width of a lobe; by default what the lights resolve.
    slopes : (light, 2)
        Of the half vectors, where the view is not N.
    second : (texel,)
        Region that shares the texel; `region` again where none does. Under few lights a shared texel is fitted under
        the prior of its region and under `Prior.shared`, and keeps the fit that is the more probable.
    """
    count = len(T)
    assert T.shape == (count, 3, len(lights))
    grid = _Lights.of(lights, slopes)
    least = resolution(lights, lobes) if narrow is None else max(narrow, NARROWEST)
    size = LOBE_SIZE * lobes + DIFFUSE_SIZE
    given = _Given(np.full(count, least), np.zeros((count, size)), np.zeros((count, size)), np.zeros(count, bool))
    shared, of_shared = np.zeros(0, np.intp), given
    if priors is not None and region is not None:
        given = _Given.of(priors, region, least, lobes)
        if second is not None and len(lights) < FEW:
            shared = np.flatnonzero(second != region)
            pairs = [one.shared(other) for one in priors for other in priors]
            of_shared = _Given.of(pairs, region[shared] * len(priors) + second[shared], least, lobes)
    solve = _Solver(TAILS[tail], lobes, bent)

    def descend(T: Samples, W: Samples, prior: _Given, first: Array | None) -> SlopeFit:
        result = _run(solve, T, W, grid, prior, iterations, first)
        if first is None and len(lights) < FEW:
            again = _at_brightest(result.shapes, T, W, grid, prior)
            result = _better(result, _run(solve, T, W, grid, prior, iterations, again), prior, prior)
        return result

    def block(at: slice) -> SlopeFit:
        result = descend(T[at], W[at], given.part(at), None if start is None else start[at])
        among = slice(*np.searchsorted(shared, (at.start, at.stop)))
        if among.stop > among.start:
            one, other = shared[among], of_shared.part(among)
            mixed = descend(T[one], W[one], other, None if start is None else start[one])
            own = result.part(one - at.start)
            result.put(one - at.start, _better(own, mixed, given.part(one), other))
        return result

    slices = [slice(k, min(k + BLOCK, count)) for k in range(0, count, BLOCK)]
    with ThreadPoolExecutor(threads) as pool:
        parts = list(pool.map(block, slices))
    if not parts:
        return SlopeFit(np.zeros((0, size)), np.zeros((0, lobes + 1, 3)), np.zeros(0))
    return _sorted(
        SlopeFit(*(np.concatenate([getattr(part, name) for part in parts]) for name in ("shapes", "colours", "cost")))
    )


@dataclass(frozen=True)
class _Solver:
    """What is solved for."""

    tail: int
    lobes: int
    bent: bool


@dataclass(frozen=True)
class _Given:
    """What is known of each texel's shapes before its samples: bounds and prior."""

    narrow: Array
    centre: Array
    stiffness: Array
    dark: NDArray[np.bool_]
    """Texels of regions whose prior was given no weight at all (`kinran.fit.strength`): amplitudes are held instead."""

    @classmethod
    def of(cls, priors: list[Prior], region: NDArray[np.intp], resolved: float, lobes: int) -> "_Given":
        """What the priors say, and the lights where these do not."""
        narrow = np.array([max(p.narrow(resolved), NARROWEST) for p in priors])
        centre, stiffness = np.stack([p.centre for p in priors]), np.stack([p.stiffness() for p in priors])
        dark = np.array([p.variance == 0 for p in priors])
        return cls(narrow[region], centre[region], stiffness[region], dark[region])

    def part(self, at: slice | NDArray[np.intp]) -> "_Given":
        """Of some texels."""
        return _Given(self.narrow[at], self.centre[at], self.stiffness[at], self.dark[at])


@dataclass(frozen=True)
class _Lights:
    """Lights as the solver takes them: rows with zeros beyond the last light."""

    slopes: Samples
    directions: Samples
    solid: Samples

    @classmethod
    def of(cls, lights: Array, slopes: Array | None) -> "_Lights":
        directions = np.asarray(lights, float)
        half = frames.slopes(directions) if slopes is None else slopes
        # the solid angle that a direction of a polar grid stands for
        solid = np.sqrt(np.maximum(1 - directions[:, 2] ** 2, 0)) + 0.02
        rows = np.zeros((6, -(-len(directions) // LANES) * LANES), np.float32)
        rows[:, : len(directions)] = *half.T, *directions.T, solid
        return cls(rows[:2], rows[2:5], rows[5])


def _row(prior: Prior) -> dict[str, Any]:
    """What a file says of a prior."""
    lone = None if prior.lone is None else _row(prior.lone)
    return {"centre": prior.centre.tolist(), "variance": prior.variance, "main": prior.main, "lone": lone}


def _prior(row: dict[str, Any]) -> Prior:
    """A prior of a file."""
    lone = None if row["lone"] is None else _prior(row["lone"])
    return Prior(np.array(row["centre"], float), float(row["variance"]), int(row["main"]), lone)


def _narrowest(lobe: Array) -> float:
    """Smallest width (1/e) of a lobe (5,), along its axes."""
    xx, xy, yy = (float(w) for w in squared_widths(lobe))
    return math.sqrt(max(0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy), 1e-12))


def _run(
    solver: _Solver,
    T: Samples,
    W: Samples,
    lights: _Lights,
    given: _Given,
    iterations: int,
    start: Array | None,
) -> SlopeFit:
    """One descent from a start."""
    count, size = len(T), LOBE_SIZE * solver.lobes + DIFFUSE_SIZE
    P = np.zeros((count, size)) if start is None else np.array(start, float)
    C, F = np.zeros((count, solver.lobes + 1, 3)), np.zeros(count)
    fused.fit_block(
        solver.tail,
        solver.lobes,
        solver.bent,
        T,
        W,
        lights.slopes,
        lights.directions,
        lights.solid,
        given.narrow,
        MAX_WIDTH,
        given.centre,
        given.stiffness,
        given.dark,
        iterations,
        SCOUTS,
        TOLERANCE,
        start is not None,
        P,
        C,
        F,
    )
    return SlopeFit(P, C, F)


def _at_brightest(shapes: Array, T: Samples, W: Samples, lights: _Lights, given: _Given) -> Array:
    """Start with the first lobe at the brightest sample, and with the prior's shapes where there is one."""
    start = np.where(given.stiffness > 0, given.centre, shapes)
    brightest = np.where(W > 0, T.mean(1), -np.inf).argmax(1)
    start[:, :2] = lights.slopes.T[brightest]
    return start


def _better(one: SlopeFit, other: SlopeFit, of_one: _Given, of_other: _Given) -> SlopeFit:
    """Of two fits of each texel, the one of less cost and penalty."""
    total = [f.cost + (g.stiffness * (f.shapes - g.centre) ** 2).sum(1) for f, g in ((one, of_one), (other, of_other))]
    take = total[1] < total[0]
    return SlopeFit(
        np.where(take[:, None], other.shapes, one.shapes),
        np.where(take[:, None, None], other.colours, one.colours),
        np.where(take, other.cost, one.cost),
    )


def _sorted(fitted: SlopeFit) -> SlopeFit:
    """The narrower of two lobes first."""
    P, C = fitted.shapes, fitted.colours
    if C.shape[1] == 3:
        swap = P[:, 2] + P[:, 4] < P[:, 7] + P[:, 9]
        order = np.r_[
            np.arange(LOBE_SIZE, 2 * LOBE_SIZE), np.arange(LOBE_SIZE), 2 * LOBE_SIZE + np.arange(DIFFUSE_SIZE)
        ]
        P[swap] = P[swap][:, order]
        C[swap] = C[swap][:, [1, 0, 2]]
    return fitted
