"""Optimal design: which directions would lower the error of a fit the most, by what the fit so far does not know.

The squared error that is expected of a prediction has two parts. What the samples leave open of the parameters is their
covariance, carried through the derivatives of the model ([Fedorov1972], [Atkinson2007]); a new direction lowers it by a
rank-one update. What no parameters could fit, or was never seen, is a Gaussian process over half-vector slopes, as
large as the errors under directions left out, which a new direction lowers around itself [Sacks1989]. Directions are
chosen one after the other, each so that it lowers the sum of both, over all directions that are judged, the most.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.fit import under_priors
from kinran.fit.cross_validation import deal, left_out
from kinran.fit.region_priors import Prior, Priors
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.lobes import DIFFUSE_SIZE, LOBE_SIZE

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SPREAD = 2.0
"""Standard deviation of a term's strength about 0 before a sample is seen, over its root mean square over texels. A
choice: so wide that a few samples outvote it."""
NUGGET = 0.02
"""Part of the misfit's variance that differs from direction to direction and cannot be learned. A choice, which keeps
the equations solvable."""
REACH = 1.0
"""Distance in slopes over which a misfit is alike, over the distance of neighbours if all directions, those to be
chosen among them, were spread evenly (docs/directions.md has half of it)."""
DOUBT = 1.0
"""Number of directions' worth of the mean misfit that is believed of a place before any direction near it."""

TEXELS = 256
"""Texels that directions are chosen by: more choose the same, and take longer. A choice."""
GROUP, LARGEST = 8, 64
"""Directions of a batch: a multiple of the first, whole shards of the stack, up to a group's."""
FAINTEST = 1e-8
"""Least variance of a sample over the mean square of all, about that of rounding: a perfect fit is no infinity."""
FOLDS = 4
"""Folds of the directions taken, each left out once. A choice: as for the weight of priors (`kinran.fit.shrinkage`)."""


def batch(taken: int) -> int:
    """Directions to choose next: a quarter of those taken, as whole shards; the fewer, the more each one is told."""
    return int(np.clip(GROUP * round(taken / (4 * GROUP)), GROUP, LARGEST))


def propose(
    samples: Samples, lobes: Lobes, priors: Priors, candidates: Array, judged: Array, count: int, share: Array
) -> "Design":
    """Choose directions by samples of some texels: their fit, and the errors of fits without some of the directions.

    Parameters
    ----------
    candidates : (m, 3)
        Directions to choose from, each once.
    judged : (n, 3)
        Directions whose errors count alike.
    count
        Number of directions to choose.
    share : (texel,)
        Weight of each texel's squared errors.
    """
    samples = samples.weighed(priors.lights)
    fitted = under_priors.fit(samples, lobes, priors)
    taken = samples.under.directions
    errors = left_out(samples, lobes, priors.regions, deal(taken, FOLDS))
    known = Known.of(fitted, samples, priors.regions, share)
    return choose(known, Misfit.of(share @ errors, taken, judged, len(taken) + count), candidates, judged, count)


@dataclass(frozen=True)
class Known:
    """What a fit knows of some texels.

    Attributes
    ----------
    fitted
        Their fit.
    taken
        Directions (light, 3) under which they were seen.
    weights : (texel, light)
        Weights of the samples; 0 for those that are not used.
    variance : (texel,)
        Variance of a sample of weight 1 about the fit.
    stiffness : (texel, K)
        Stiffness of the prior on the shapes.
    share : (texel,)
        Weight of each texel's squared errors.
    """

    fitted: SlopeFit
    taken: Array
    weights: Array
    variance: Array
    stiffness: Array
    share: Array

    @classmethod
    def of(cls, fitted: SlopeFit, samples: Samples, priors: list[Prior], share: Array) -> "Known":
        """What a fit under these priors knows of samples; their variance is that of the residuals of their region."""
        freedom = np.maximum(3 * (samples.W > 0).sum(1) - fitted.numbers, 1)
        known = np.bincount(samples.region, fitted.cost, len(priors)) / np.maximum(
            np.bincount(samples.region, freedom, len(priors)), 1
        )
        variance = np.maximum(known, FAINTEST * float(np.mean(np.square(samples.T), where=samples.usable())))
        stiffness = np.stack([prior.stiffness() for prior in priors])[samples.region]
        return cls(
            fitted, samples.under.directions, samples.W.astype(float), variance[samples.region], stiffness, share
        )

    def covariances(self) -> Array:
        """Covariance (texel, P, P) of the shapes and of the strengths of the terms."""
        strengths = _strengths(self.fitted)
        typical = np.maximum((strengths**2).mean(0), 1e-12)
        J = gradients(self.fitted, self.taken)
        information = np.swapaxes(J * self.weights[:, :, None], 1, 2) @ J
        weak = self.variance[:, None] / (SPREAD**2 * typical)
        prior = np.concatenate([self.stiffness, weak], 1)
        places = np.arange(prior.shape[1])
        information[:, places, places] += np.maximum(prior, 1e-9 * information[:, places, places].max(1)[:, None])
        return np.linalg.inv(information) * self.variance[:, None, None]


def gradients(fitted: SlopeFit, directions: Array) -> Array:
    """Derivatives (texel, light, K + lobes + 1) of T by the shapes of a fit, and by the strengths of its terms.

    T is taken without its colour: a term is as strong as its colour is long (Euclidean norm over the channels).
    """
    P, strengths = fitted.shapes, _strengths(fitted)
    size, lobes = P.shape[1], fitted.lobes.count
    sx, sy = frames.slopes(directions).T
    J = np.empty((len(P), len(directions), size + lobes + 1))
    for k in range(lobes):
        mx, my, alpha, beta, gamma = (column[:, None] for column in fitted.lobe(k).T)
        dx, dy = sx - mx, sy - my
        ea, ec = np.exp(alpha), np.exp(gamma)
        u, v = ea * dx + beta * dy, ec * dy
        q = u * u + v * v
        G = np.exp(-q) if fitted.lobes.tail == "gaussian" else (1 + q) ** -2
        fall = 2 * (-G if fitted.lobes.tail == "gaussian" else -2 * G / (1 + q)) * strengths[:, k, None]  # 2 dG/dq
        by = (-fall * u * ea, -fall * (u * beta + v * ec), fall * u * ea * dx, fall * u * dy, fall * v * v)
        J[:, :, LOBE_SIZE * k : LOBE_SIZE * (k + 1)] = np.stack(by, 2)
        J[:, :, size + k] = G
    nx, ny = P[:, size - DIFFUSE_SIZE :].T[:, :, None]
    lx, ly, lz = directions.T
    cosine = lz + nx * lx + ny * ly
    lit = (cosine > 0) * strengths[:, lobes, None]
    J[:, :, size - DIFFUSE_SIZE], J[:, :, size - 1] = lit * lx, lit * ly
    J[:, :, size + lobes] = np.maximum(cosine, 0)
    return J


def _strengths(fitted: SlopeFit) -> Array:
    return np.asarray(np.linalg.norm(fitted.colours, axis=2))


@dataclass(frozen=True)
class Misfit:
    """What is believed of the part of T that the model does not fit, as a Gaussian process over half-vector slopes.

    Attributes
    ----------
    reach
        Distance in slopes over which it is alike: its covariance is exp(-d² / 2 reach²).
    square : (judged,)
        Expected square of it under each direction that is judged, summed over the texels by their share.
    """

    reach: float
    square: Array

    @classmethod
    def of(cls, errors: Array, taken: Array, judged: Array, total: int) -> "Misfit":
        """What squared errors (light,) under the directions taken, each left out of its fit, say of others.

        Parameters
        ----------
        total
            Number of directions, those to be chosen among them, which sets the reach.
        """
        rim = float(np.linalg.norm(frames.slopes(judged), axis=1).max())
        reach = REACH * np.sqrt(np.pi * rim * rim / total)
        near = _alike(judged, taken, reach)
        return cls(reach, (near @ errors + DOUBT * errors.mean()) / (near.sum(1) + DOUBT))


def _alike(one: Array, other: Array, reach: float) -> Array:
    """Covariance (m, n) of a misfit of variance 1 at directions (m, 3) and (n, 3)."""
    s, t = frames.slopes(one), frames.slopes(other)
    square = (s**2).sum(1)[:, None] + (t**2).sum(1) - 2 * s @ t.T
    return np.asarray(np.exp(-0.5 * np.maximum(square, 0) / reach**2))


@dataclass(frozen=True)
class Design:
    """Directions that were chosen.

    Attributes
    ----------
    chosen : (count,)
        Indices of the candidates, in the order in which they were chosen.
    expected : (count + 1,)
        Sum of squared errors over texels and judged directions that is expected before any of them, and after each.
    """

    chosen: Indices
    expected: Array


def choose(known: Known, misfit: Misfit, candidates: Array, judged: Array, count: int) -> Design:
    """Choose directions that lower the squared error expected over the judged directions the most.

    Parameters
    ----------
    candidates : (m, 3)
        Directions to choose from, each once.
    judged : (n, 3)
        Directions whose errors count alike.
    count
        Number of directions to choose, at most m.
    """
    parameters, unfitted = _Parameters(known, candidates, judged), _Unfitted(known, misfit, candidates, judged)
    free, chosen = np.ones(len(candidates), bool), []
    expected = [parameters.expected + unfitted.expected]
    for _ in range(min(count, len(candidates))):
        gain = np.where(free, parameters.gains() + unfitted.gains(), -np.inf)
        best = int(gain.argmax())
        parameters.take(best)
        unfitted.take(best)
        free[best] = False
        chosen.append(best)
        expected.append(max(expected[-1] - float(gain[best]), 0.0))
    return Design(np.array(chosen, np.intp), np.array(expected))


class _Parameters:
    """Error by the parameters of each texel, and by how much each candidate would lower it."""

    def __init__(self, known: Known, candidates: Array, judged: Array) -> None:
        covariance = known.covariances()
        J = gradients(known.fitted, judged)
        self.judged = np.swapaxes(J, 1, 2) @ J * known.share[:, None, None]  # (texel, P, P)
        self.expected = float((covariance * self.judged).sum())
        self.J = gradients(known.fitted, candidates)
        self.moved = self.J @ covariance  # (texel, candidate, P): J Σ
        self.least = known.variance[:, None]
        self.total = self.least + (self.moved * self.J).sum(2)  # variance of the sample to come

    def gains(self) -> Array:
        """J Σ A Σ Jᵀ over the variance of the sample to come, summed over texels."""
        return np.asarray((((self.moved @ self.judged) * self.moved).sum(2) / self.total).sum(0))

    def take(self, k: int) -> None:
        """Σ becomes Σ − Σ jᵀ j Σ over the variance of the sample that came."""
        step = self.moved[:, k] / np.sqrt(self.total[:, k])[:, None]
        along = np.einsum("tmp,tp->tm", self.J, step)
        self.moved -= along[:, :, None] * step[:, None]
        self.total = np.maximum(self.total - along**2, self.least)


class _Unfitted:
    """Error by what the model does not fit, and by how much each candidate would lower it."""

    def __init__(self, known: Known, misfit: Misfit, candidates: Array, judged: Array) -> None:
        among = _alike(known.taken, known.taken, misfit.reach) + NUGGET * np.eye(len(known.taken))
        to_candidates = _alike(known.taken, candidates, misfit.reach)
        to_judged = _alike(known.taken, judged, misfit.reach)
        solved = np.linalg.solve(among, to_candidates)
        self.square = misfit.square
        left = 1 - (to_judged * np.linalg.solve(among, to_judged)).sum(0)
        self.expected = float(self.square @ np.maximum(left, 0))
        self.own = _alike(candidates, candidates, misfit.reach) - to_candidates.T @ solved
        self.of_judged = _alike(judged, candidates, misfit.reach) - to_judged.T @ solved

    def gains(self) -> Array:
        """Squared covariance with the judged directions over the variance of the sample to come."""
        return np.asarray(self.square @ self.of_judged**2 / (np.maximum(np.diag(self.own), 0) + NUGGET))

    def take(self, k: int) -> None:
        """Condition the process on the sample that came."""
        own, of_judged = self.own[:, k].copy(), self.of_judged[:, k].copy()
        variance = max(own[k], 0.0) + NUGGET
        self.own -= np.outer(own, own) / variance
        self.of_judged -= np.outer(of_judged, own) / variance
