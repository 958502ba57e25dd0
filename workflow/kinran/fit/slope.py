"""Fit the `slope` model to samples: bounds, priors, starts, threads."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.data.texel_directions import Index, Under
from kinran.fit.fitted_model import Channels, named
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver import fused, prepare
from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE, TAILS, squared_widths
from kinran.fit.solver.rows import LANES
from kinran.fit.solver.sums import summed

Array = NDArray[np.float64]
Single = NDArray[np.float32]

ITERATIONS = 12
"""Most iterations of a search; `kinran bench fit` measures the error after fewer."""
TOLERANCE = 3e-4
"""Share of the cost that a step has to promise, and to gain, for the search to go on. A choice; `kinran bench fit`
measures the error and the time that it leads to."""
BLOCK = 256
"""Texels of a job of a thread: 3.5 MB of samples under the paper's grid."""
MAX_WIDTH = 2.0
"""Largest width (1/e, in slopes) of a lobe: twice the slope of the half vector at the horizon."""
NARROWEST = 0.02
"""Smallest width (1/e, in slopes) of a lobe. A choice: half of the distance of lights 5° apart is 0.022."""
SCOUTS = 2
"""Most iterations of the lone GGX lobe that two lobes start from. A choice."""
NEEDLE = {1: 0.5, 2: 0.6}
"""Width, over the distance of neighbouring lights, below which one or two lobes are needles between lights. `kinran
bench stability` compares these widths with a fixed one."""
FEW = 150
"""Number of lights below which a lobe may stand between them: a second start is tried, at the brightest sample, and a
second prior at texels that two regions share. From this number on, samples outvote both priors (docs/fit.md, "Mixed
texels")."""


@dataclass(frozen=True)
class SlopeFit:
    """Lobes fitted to texels.

    Attributes
    ----------
    lobes
        Lobes that were fitted.
    shapes : (texel, K) float64
        (μ_x, μ_y, α, β, γ) of each lobe, the narrower lobe first, then the slopes of the diffuse normal.
    colours : (texel, lobes + 1, 3) float64
        Amplitudes of the lobes and of the diffuse term, in the unit of the samples.
    cost : (texel,) float64
        Weighted sum of the squared residuals.
    widened : (texel,) bool
        Whether `kinran.fit.unseen_peaks` has held a lobe that was a needle between lights.
    """

    lobes: Lobes
    shapes: Array
    colours: Array
    cost: Array
    widened: NDArray[np.bool_]

    @classmethod
    def empty(cls, lobes: Lobes, texels: int) -> "SlopeFit":
        """A fit of zeros, to be filled by `put`."""
        shapes, colours = np.zeros((texels, lobes.size)), np.zeros((texels, lobes.count + 1, 3))
        return cls(lobes, shapes, colours, np.zeros(texels), np.zeros(texels, bool))

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return self.shapes.shape[1] + 3 * self.colours.shape[1]

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return 0

    def of(self, at: Index) -> "SlopeFit":
        """The fit of some texels."""
        return SlopeFit(self.lobes, self.shapes[at], self.colours[at], self.cost[at], self.widened[at])

    def put(self, at: Index, part: "SlopeFit") -> None:
        """Take the fit of some texels from another."""
        self.shapes[at], self.colours[at], self.cost[at] = part.shapes, part.colours, part.cost
        self.widened[at] = part.widened

    def copy(self) -> "SlopeFit":
        """A fit that can be changed without this one."""
        return self.of(np.arange(len(self.shapes)))

    def lobe(self, k: int) -> Array:
        """Shapes (texel, 5) of a lobe."""
        return self.shapes[:, LOBE_SIZE * k : LOBE_SIZE * (k + 1)]

    def predict(self, under: Under) -> Single:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        prepare()
        out = np.empty((len(self.shapes), 3, under.count), np.float32)
        tail = TAILS[self.lobes.tail]
        for k, at in under.cells():
            part = out[at]  # the texels themselves of a lone cell, a copy of those of others
            summed(tail, self.shapes[at], self.colours[at], under.slopes[k], under.lights[k], part)
            out[at] = part
        return out

    def channels(self) -> Channels:
        """Channels (texel,) of the material's maps."""
        lobes = [self.lobe(k) for k in range(self.lobes.count)]
        shapes = [np.stack([p[:, 0], p[:, 1], *squared_widths(p)], 1) for p in lobes]
        channels = named(("x", "y", "xx", "xy", "yy"), np.concatenate(shapes, 1), self.colours)
        channels["diffuse.x"], channels["diffuse.y"] = self.shapes[:, -DIFFUSE_SIZE:].T
        channels["fit.widened"] = self.widened.astype(float)
        return channels


def resolution(lights: Array, lobes: int = 1) -> float:
    """Smallest lobe width (1/e, in slopes) that light directions (n, 3) can tell from a needle between two lights.

    It is `NEEDLE` times the median distance to the nearest other light in slope space, and at least `NARROWEST`.
    """
    s = frames.slopes(lights)
    if len(s) < 2:
        return MAX_WIDTH / 2
    nearest = frames.nearest(s, 2)[0][:, 1]
    return float(np.clip(NEEDLE[lobes] * np.median(nearest), NARROWEST, MAX_WIDTH / 2))


def fit(
    samples: Samples,
    lobes: Lobes,
    priors: list[Prior] | None = None,
    threads: int = 1,
    start: Array | None = None,
    narrow: float | None = None,
    gaps: Array | None = None,
    iterations: int = ITERATIONS,
) -> SlopeFit:
    """Fit lobes in slope space and a diffuse term to each texel.

    Samples that are not finite are left out. Under few lights a texel that two regions share is fitted under the prior
    of its region and under `Prior.shared`, and keeps the fit that is the more probable.

    Parameters
    ----------
    priors
        A prior for each region; without them every texel stands alone.
    threads
        Number of threads; the result does not depend on it.
    start : (texel, K)
        Shapes to start from; by default the moments of the highlight give them.
    narrow
        Smallest width of a lobe (1/e, in slopes); by default the width that the lights resolve.
    gaps : (texel,)
        Widths that lobes may not be narrower than, whatever the lights and the priors resolve elsewhere.
    iterations
        Most iterations of a search.
    """
    assert samples.T.shape == (len(samples), 3, samples.under.count)
    prepare()
    # for another layout the solver would be compiled anew
    samples = replace(samples, T=np.ascontiguousarray(samples.T), W=np.ascontiguousarray(samples.W))
    least = _least(samples.under, lobes, narrow)
    gaps = np.zeros(len(samples)) if gaps is None else gaps
    given = _nothing(least, lobes) if priors is None else _given(priors, samples.region, least)
    job = _Job(samples, lobes, priors, least, gaps, _no_narrower(given, gaps), start, iterations)
    result = SlopeFit.empty(lobes, len(samples))

    def block(at: tuple[int, Index]) -> None:
        result.put(at[1], job.block(*at))

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(block, _blocks(samples)))
    return _sorted(result)


def _blocks(samples: Samples) -> list[tuple[int, Index]]:
    """Blocks of texels of one cell: the cell, and their places."""
    blocks: list[tuple[int, Index]] = []
    for cell, at in samples.under.cells():
        if isinstance(at, slice):
            blocks += [(cell, slice(k, min(k + BLOCK, len(samples)))) for k in range(0, len(samples), BLOCK)]
        else:
            blocks += [(cell, at[k : k + BLOCK]) for k in range(0, len(at), BLOCK)]
    return blocks


def _least(under: Under, lobes: Lobes, narrow: float | None) -> Array:
    """Smallest width (texel,) of a lobe: `narrow`, or the width that the lights resolve."""
    least = np.empty(len(under.cell))
    for cell, at in under.cells():
        least[at] = resolution(under.lights[cell], lobes.count) if narrow is None else max(narrow, NARROWEST)
    return least


class Light(NamedTuple):
    """Half-vector slopes (2, row), directions (3, row) and the solid angle (row,) that a light stands for.

    Rows are as long as a multiple of `LANES`, with zeros beyond the last light.
    """

    S: Single
    L: Single
    solid: Single


class Given(NamedTuple):
    """Bounds and priors of texels.

    Attributes
    ----------
    narrow : (texel,)
        Smallest width of a lobe; `wide` is the largest.
    centre, stiffness : (texel, K)
        Prior: F + Σ ρ_k (p_k - p̄_k)².
    dark : (texel,) bool
        Whether a prior holds the amplitudes of Gaussian lobes, one of two or over a bent diffuse term.
    """

    narrow: Array
    wide: float
    centre: Array
    stiffness: Array
    dark: NDArray[np.bool_]


@dataclass(frozen=True)
class _Job:
    """Samples, model and priors of a fit, which is done block by block."""

    samples: Samples
    lobes: Lobes
    priors: list[Prior] | None
    least: Array
    gaps: Array
    given: Given
    start: Array | None
    iterations: int

    def block(self, cell: int, at: Index) -> SlopeFit:
        """Fit of some texels of one cell."""
        samples = self.samples
        T, W, region = samples.T[at], samples.W[at], samples.region[at]
        lights = _rows(samples.under.lights[cell], samples.under.slopes[cell])
        start = None if self.start is None else self.start[at]
        given = _of_texels(self.given, at)
        result = self._descend(T, W, lights, given, start)
        one = np.flatnonzero(samples.second[at] != region)
        if self.priors is not None and len(one) and samples.under.count < FEW:
            of = [r.shared(s) for r in self.priors for s in self.priors]
            pair = region[one] * len(self.priors) + samples.second[at][one]
            other = _no_narrower(_given(of, pair, self.least[at][one]), self.gaps[at][one])
            mixed = self._descend(T[one], W[one], lights, other, None if start is None else start[one])
            result.put(one, _better(result.of(one), mixed, _of_texels(given, one), other))
        return result

    def _descend(self, T: Single, W: Single, lights: Light, given: Given, start: Array | None) -> SlopeFit:
        result = self._run(T, W, lights, given, start)
        if start is None and self.samples.under.count < FEW:
            again = _at_brightest(result.shapes, T, W, lights, given)
            result = _better(result, self._run(T, W, lights, given, again), given, given)
        return result

    def _run(self, T: Single, W: Single, lights: Light, given: Given, start: Array | None) -> SlopeFit:
        """One descent from a start."""
        found = SlopeFit.empty(self.lobes, len(T))
        if start is not None:
            found.shapes[:] = start
        fused.fit_block(
            TAILS[self.lobes.tail],
            self.lobes.count,
            self.lobes.bent,
            T,
            W,
            lights.S,
            lights.L,
            lights.solid,
            given.narrow,
            given.wide,
            given.centre,
            given.stiffness,
            given.dark,
            self.iterations,
            SCOUTS,
            TOLERANCE,
            start is not None,
            found.shapes,
            found.colours,
            found.cost,
        )
        return found


def _nothing(least: Array, lobes: Lobes) -> Given:
    """Bounds without a prior, for widths of at least `least` (texel,)."""
    count = len(least)
    return Given(least, MAX_WIDTH, np.zeros((count, lobes.size)), np.zeros((count, lobes.size)), np.zeros(count, bool))


def _given(priors: list[Prior], region: NDArray[np.intp], least: Array) -> Given:
    """Bounds and priors of texels by their region (texel,).

    A lobe may be as narrow as its region's where that is narrower than the lights resolve. Where a prior has no weight
    at all (`kinran.fit.shrinkage`), amplitudes are held instead.
    """
    widths = np.array([prior.narrowest for prior in priors])
    centre, stiffness = np.stack([p.centre for p in priors]), np.stack([p.stiffness() for p in priors])
    dark = np.array([prior.variance == 0 for prior in priors])
    narrow = np.maximum(np.minimum(least, widths[region]), NARROWEST)
    return Given(narrow, MAX_WIDTH, centre[region], stiffness[region], dark[region])


def _no_narrower(given: Given, gaps: Array) -> Given:
    """Bounds and priors for widths of at least those of gaps (texel,)."""
    return given._replace(narrow=np.maximum(given.narrow, gaps))


def _of_texels(given: Given, at: Index) -> Given:
    """Bounds and priors of some of the texels."""
    return Given(given.narrow[at], given.wide, given.centre[at], given.stiffness[at], given.dark[at])


def _rows(directions: Array, half: Array) -> Light:
    """Lights (light, 3) and half-vector slopes (light, 2) in the solver's layout."""
    # the solid angle that a direction of a polar grid stands for
    solid = np.sqrt(np.maximum(1 - directions[:, 2] ** 2, 0)) + 0.02
    rows = np.zeros((6, -(-len(directions) // LANES) * LANES), np.float32)
    rows[:, : len(directions)] = *half.T, *directions.T, solid
    return Light(rows[:2], rows[2:5], rows[5])


def _at_brightest(shapes: Array, T: Single, W: Single, lights: Light, given: Given) -> Array:
    """Shapes (texel, K) to start from: the first lobe at the brightest sample, the rest from the prior if any."""
    start = np.where(given.stiffness > 0, given.centre, shapes)
    brightest = np.where(W > 0, T.mean(1), -np.inf).argmax(1)
    start[:, :2] = lights.S.T[brightest]
    return start


def _better(one: SlopeFit, other: SlopeFit, of_one: Given, of_other: Given) -> SlopeFit:
    """The better of two fits of each texel, by cost and the prior's penalty together."""
    total = [f.cost + (g.stiffness * (f.shapes - g.centre) ** 2).sum(1) for f, g in ((one, of_one), (other, of_other))]
    take = total[1] < total[0]
    return SlopeFit(
        one.lobes,
        np.where(take[:, None], other.shapes, one.shapes),
        np.where(take[:, None, None], other.colours, one.colours),
        np.where(take, other.cost, one.cost),
        np.where(take, other.widened, one.widened),
    )


def _sorted(fitted: SlopeFit) -> SlopeFit:
    """The fit with the narrower of two lobes first."""
    P, C = fitted.shapes, fitted.colours
    if C.shape[1] == 3:
        swap = P[:, 2] + P[:, 4] < P[:, 7] + P[:, 9]
        order = np.r_[
            np.arange(LOBE_SIZE, 2 * LOBE_SIZE), np.arange(LOBE_SIZE), 2 * LOBE_SIZE + np.arange(DIFFUSE_SIZE)
        ]
        P[swap] = P[swap][:, order]
        C[swap] = C[swap][:, [1, 0, 2]]
    return fitted
