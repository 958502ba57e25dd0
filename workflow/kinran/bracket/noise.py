"""Noise of a camera from a bracket of any still scene, whose exposures predict each other; σ of a stack."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from kinran.bracket.estimator import TAPER
from kinran.data.calibration import MARGIN

Array = NDArray[np.float64]
Counts = NDArray[np.uint16]

MOST_SITES = 300_000
"""Most sites that are used: they measure the variance of each bin to 1 %."""
BINS = 24
"""Bins of the level, of equal numbers of sites, in which the variance is measured: a choice."""
LEAST_IN_BIN = 30
"""Fewest sites of a bin that is used: they measure its variance to a quarter."""
MOST_CUT = 0.005
"""Largest share of counts at 0 in a bin that is used, since clipping at 0 makes its variance too small: a choice."""
LEAST_GAIN = 1e-7
"""Least gain, relative to saturation: no camera holds ten million electrons in a site."""
ROUNDING = 12**-0.5
"""Standard deviation of rounding to whole numbers."""


class Noise(NamedTuple):
    """Noise of a camera; attributes are those of `Response`."""

    gain: float
    read: float
    coding: float


def measure_noise(planes: Counts, black: Array, seconds: Array, clip: float) -> Noise:
    """Measure the noise of a camera on one of its brackets.

    A longer exposure y and the ratio r predict r y for the next shorter one, which differs by noise alone: the scene
    and the sites' own responses cancel. The variance of the difference is gain m (1 + r) + read² (1 + r²) +
    2 coding² m² for a prediction of m counts. Levels that are clipped at 0, as in photographs, are left out.

    Parameters
    ----------
    planes : (exposure, plane, y, x) uint16
        Longest exposure first.
    black : (exposure, plane, y) float
        Black levels of each row in counts.
    seconds : (exposure, y) float
        True times in seconds.
    clip
        Saturation in counts over black.
    """
    least = np.array([clip * LEAST_GAIN, rounding(planes) ** 2, 0.0])
    if len(planes) == 1:
        return _from_neighbours(planes[0], black[0], clip, least)
    rows, variances, weights = [], [], []
    step = max(1, round((planes[0].size / MOST_SITES) ** 0.5))
    some = planes[:, :, ::step, ::step]
    for k in range(len(planes) - 1):
        r = (seconds[k + 1] / seconds[k])[::step]
        longer = some[k] - black[k, :, ::step, None]
        predicted = longer * r[:, None]
        difference = some[k + 1] - black[k + 1, :, ::step, None] - predicted
        open_ = (longer < 0.9 * clip) & (longer > -0.01 * clip)
        cut = np.minimum(some[k], some[k + 1]) == 0
        for level, variance, count in _bins(predicted[open_], difference[open_], cut[open_]):
            m, mean = max(level, 0.0), float(r.mean())
            rows.append([m * (1 + mean), 1 + mean**2, 0.0 if len(planes[0]) == 4 else 2 * m * m])
            variances.append(variance)
            weights.append(np.sqrt(count))
    return _solve(np.array(rows).reshape(-1, 3), np.array(variances), np.array(weights), clip, least)


def sigma(radiance: NDArray[np.float32], noise: dict[str, Any]) -> Array:
    """Return the standard deviation (..., 3) of the radiance (..., 3) of a stack of RAW brackets, by its noise model.

    It combines photon noise, read noise and rounding of the exposures under saturation with the sites' unequal
    response, which is the same under all lights. It is infinite where all exposures are saturated.

    Parameters
    ----------
    radiance : (..., 3)
        Radiance in the stack's unit.
    noise
        Noise model `Stack.noise`.
    """
    rate = np.maximum(np.asarray(radiance, float), 0) * np.array(noise["white_counts_per_second"])
    gain, read, clip = noise["counts_per_electron"], noise["read_counts"], MARGIN * noise["saturation_counts"]
    coding = noise.get("relative_coding", 0.0)
    information = np.zeros_like(rate)
    for seconds in noise["seconds"]:
        expected = rate * seconds
        shortest = seconds == min(noise["seconds"])
        weight = expected < clip if shortest else np.clip((clip - expected) / (clip * (1 - TAPER)), 0, 1)
        information += weight * seconds**2 / (expected * (gain + coding**2 * expected) + read**2)
    sites = np.array([1, 2, 1]) if noise.get("planes", 4) == 4 else np.ones(3)
    with np.errstate(divide="ignore"):
        variance = 1 / (information * sites) + (noise["relative_prnu"] * rate) ** 2 / sites
    return np.asarray(np.sqrt(variance) / np.array(noise["white_counts_per_second"]))


def rounding(planes: Counts) -> float:
    """Return the standard deviation of rounding: 12^-1/2 of the smallest step of counts, 1 in RAW, more in 8 bits."""
    seen = np.flatnonzero(np.bincount(planes[..., ::3, ::3].ravel()))
    return float(np.diff(seen).min() * ROUNDING) if len(seen) > 1 else ROUNDING


def _from_neighbours(planes: Counts, black: Array, clip: float, least: Array) -> Noise:
    """Measure the noise of one frame on neighbouring sites: texture counts as noise, so that it is an upper bound."""
    one, other = (planes[1], planes[2]) if len(planes) == 4 else (planes[1, :, ::2][:, :-1], planes[1, :, 1::2])
    width = min(one.shape[1], other.shape[1])
    pair = np.stack([one[:, :width], other[:, :width]]).reshape(2, -1)
    mean, difference = (pair - black[1].mean()).mean(0), pair[0].astype(float) - pair[1]
    open_ = mean < 0.9 * clip
    found = _bins(mean[open_], difference[open_], (pair.min(0) == 0)[open_])
    rows = np.array([[2 * max(level, 0.0), 2.0, 0.0] for level, _, _ in found])
    return _solve(
        rows.reshape(-1, 3),
        np.array([variance for _, variance, _ in found]),
        np.array([np.sqrt(count) for _, _, count in found]),
        clip,
        least,
    )


def _bins(level: Array, difference: Array, cut: NDArray[np.bool_]) -> list[tuple[float, float, int]]:
    """Return mean level, variance without outliers, and number of sites of each bin that is not clipped at 0."""
    order = np.argsort(level, kind="stable")
    found = []
    for part in np.array_split(order, BINS):
        if len(part) < LEAST_IN_BIN or cut[part].mean() > MOST_CUT:
            continue
        kept = difference[part]
        for _ in range(4):
            kept = kept[np.abs(kept - np.median(kept)) <= 4 * kept.std()]
        found.append((float(level[part].mean()), float(kept.var()), len(kept)))
    return found


def _solve(rows: Array, variances: Array, weights: Array, clip: float, least: Array) -> Noise:
    """Solve for (gain, read², coding²) ≥ `least` by least squares, each variance weighted by its own error."""
    from scipy.optimize import nnls

    if len(rows) < 2:
        return Noise(float(clip / 30_000), float(max(np.sqrt(least[1]), 1e-3 * clip)), 0.0)
    model = np.maximum(variances, least[1])
    for _ in range(3):
        w = weights / model
        scale = np.maximum(np.abs(rows * w[:, None]).max(0), 1e-30)
        over, _ = nnls(rows * w[:, None] / scale, (variances - rows @ least) * w)
        solution = least + over / scale
        model = np.maximum(rows @ solution, least[1])
    return Noise(float(solution[0]), float(np.sqrt(solution[1])), float(np.sqrt(solution[2])))
