"""What of a set is not to be trusted: lights that do not fit in with their neighbours, samples that are outliers.

Lobes are no exact model, and what they leave is not noise: a robust loss everywhere would cost more than it gains. But
their residual is as smooth over the lights as a highlight is. A light that stands elsewhere than its list says, or
flickered, leaves more than its neighbours do in most texels; an outlier leaves more in its own.
"""

import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinran import frames
from kinran.files import read_json
from kinran.fit import reweighted, slope
from kinran.fit.predict import predict
from kinran.stack import Light

Array = NDArray[np.float64]
Samples = NDArray[np.float32]

NEIGHBOURS = 6
ODD = 2.0
"""How much more than its neighbours a light may leave."""
ROUNDS = 2
BETTER = 0.4
"""Share of the smooth part of the squares of least squares under which Huber's loss is taken for all texels."""


@dataclass(frozen=True)
class Trust:
    """What the fits take of a set.

    Attributes
    ----------
    lights : (light,) float32
        Factors of the weights of each light's samples.
    outliers
        Whether the loss is Huber's.
    """

    lights: Samples
    outliers: bool

    def row(self, lights: list[Light]) -> dict[str, Any]:
        """What a file says of it: the lights that have not their full weight, by name."""
        odd = {light.name: round(float(w), 4) for light, w in zip(lights, self.lights, strict=True) if w < 1}
        return {"lights": odd, "outliers": self.outliers}


def read(path: Path, lights: list[Light]) -> Trust:
    """What the file of the priors says of these lights."""
    row = read_json(path)["trust"]
    return Trust(np.array([row["lights"].get(light.name, 1) for light in lights], np.float32), row["outliers"])


def learn(T: Samples, W: Samples, lights: Array, tail: str, lobes: int, threads: int) -> Trust:
    """What to trust, by free fits to a sample of texels; parameters as of `kinran.fit.slope.fit`."""
    near = cKDTree(frames.slopes(lights)).query(frames.slopes(lights), min(NEIGHBOURS + 1, len(lights)))[1]
    factors = np.ones(len(lights), np.float32)
    if len(lights) <= NEIGHBOURS or not len(T):
        return Trust(factors, False)
    fit = partial(slope.fit, lobes=lobes, threads=threads)
    free = fit(T, W, lights, tail)
    for _ in range(ROUNDS):
        found = np.minimum(1, (ODD / oddness(_left(T, W, free, lights, tail), near)) ** 2).astype(np.float32)
        if (found == factors).all():
            break
        factors = found
        free = fit(T, W * factors, lights, tail)
    W = W * factors
    huber = reweighted.robust(T, W, lights, tail, fit)[0]
    smooth = [_smooth(_left(T, W, fitted, lights, tail), W, near) for fitted in (huber, free)]
    return Trust(factors, smooth[0] < BETTER * smooth[1])


def oddness(left: Array, near: NDArray[np.intp]) -> Array:
    """How much more each light leaves, in the median of the texels, than its neighbours.

    Parameters
    ----------
    left : (texel, light)
        Size of residuals; NaN where a sample is not used.
    near : (light, k) int
        Each light and its neighbours.
    """
    own = np.nanmedian(left / np.maximum(np.nanmedian(left, 1, keepdims=True), 1e-12), 0)
    return np.asarray(own / np.maximum(np.median(own[near[:, 1:]], 1), 1e-12))


def _left(T: Samples, W: Samples, fitted: slope.SlopeFit, lights: Array, tail: str) -> Array:
    size = np.linalg.norm(np.nan_to_num(T) - predict(fitted, lights, tail), axis=1)
    return np.where(W > 0, size, np.nan)


def _smooth(left: Array, W: Samples, near: NDArray[np.intp]) -> float:
    """Sum of the squares of residuals, each the median of its neighbourhood."""
    known = np.nan_to_num(left)
    return float((W * np.median(known[:, near], 2) ** 2).sum())


def say(trust: Trust, lights: list[Light]) -> None:
    """Tell which lights do not fit in, and whether there are outliers."""
    for name, weight in trust.row(lights)["lights"].items():
        print(f"light {name}: does not fit in with its neighbours; weight {weight:.2g}", file=sys.stderr)
    if trust.outliers:
        print("some samples are outliers: the fit takes Huber's loss", file=sys.stderr)
