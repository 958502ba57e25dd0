"""A bracket: the same view at several exposures, merged to radiance before any demosaic.

Two passes over the counts of one sensor site, without a temporary picture. The first predicts the signal
from the shortest exposure upwards; the second is the mean with weights from the *predicted* variance (a
weight from the noisy value itself is biased in the dark), tapered to zero under saturation.
"""

from dataclasses import dataclass

import numba as nb
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.float32]
Counts = NDArray[np.uint16]

TAPER = 0.92
"""From this share of saturation on an exposure loses its say, so that no step shows where it ends."""
MARGIN = 0.99
"""Counts over this share of the measured saturation are saturated."""
DARK_SIGMA = 3.0


@dataclass(frozen=True)
class Response:
    """What a sensor makes of electrons.

    Attributes
    ----------
    saturation
        Counts over black at which a site is full.
    gain
        Counts per electron.
    read
        Standard deviation of darkness in counts, rounding included.
    """

    saturation: float
    gain: float
    read: float

    @property
    def clip(self) -> float:
        """Counts over black from which on a site is taken as saturated."""
        return MARGIN * self.saturation


def estimate(
    counts: Counts, black: NDArray[np.float64], seconds: NDArray[np.float64], response: Response
) -> tuple[Image, Image]:
    """Merge one plane of a bracket.

    Parameters
    ----------
    counts : (exposure, ...) uint16
    black : (exposure,) float
        Count of darkness of each frame.
    seconds : (exposure,) float
        True shutter times, in any order.
    response
        Of the sensor.

    Returns
    -------
    rate : (...) float32
        Counts a second. Where every exposure is saturated, what the shortest shows: a lower bound.
    sigma : (...) float32
        Its standard deviation; infinite where every exposure is saturated.
    """
    order = np.argsort(-seconds, kind="stable")
    flat = np.ascontiguousarray(counts[order].reshape(len(seconds), -1))
    rate, sigma = np.empty(flat.shape[1], np.float32), np.empty(flat.shape[1], np.float32)
    _merge(
        flat,
        black[order].astype(np.float32),
        seconds[order].astype(np.float32),
        np.float32(response.clip),
        np.float32(response.gain),
        np.float32(response.read**2),
        rate,
        sigma,
    )
    return rate.reshape(counts.shape[1:]), sigma.reshape(counts.shape[1:])


@nb.njit(cache=True, error_model="numpy", fastmath={"nsz", "arcp", "contract", "reassoc"})  # type: ignore[untyped-decorator,unused-ignore]
def _merge(
    counts: Counts,
    black: Image,
    seconds: Image,
    clip: np.float32,
    gain: np.float32,
    read: np.float32,
    rate: Image,
    sigma: Image,
) -> None:
    """`estimate` for flat counts, longest exposure first; `read` is a variance."""
    n, zero, one, tiny = counts.shape[0], np.float32(0), np.float32(1), np.float32(1e-30)
    width = np.float32(1) / (clip * np.float32(1 - TAPER))
    for p in range(counts.shape[1]):
        shortest = np.float32(counts[n - 1, p]) - black[n - 1]
        unsaturated = one if shortest < clip else zero
        signal, time = unsaturated * shortest, unsaturated * seconds[n - 1]
        for i in range(n - 2, -1, -1):
            y = np.float32(counts[i, p]) - black[i]
            expected = max(signal, zero) / (time + tiny) * seconds[i]
            weight = min(max((clip - max(expected, y)) * width, zero), one)
            signal += weight * y
            time += weight * seconds[i]
        predicted = max(signal, zero) / (time + tiny)
        top, bottom = zero, zero
        for i in range(n):
            y = np.float32(counts[i, p]) - black[i]
            expected = predicted * seconds[i]
            weight = unsaturated
            if i < n - 1:
                weight = min(max((clip - max(expected, y)) * width, zero), one)
            information = weight * seconds[i] / (gain * expected + read)
            top += information * y
            bottom += information * seconds[i]
        if bottom > zero:
            rate[p] = top / bottom
            sigma[p] = np.sqrt(one / bottom)
        else:
            rate[p] = shortest / seconds[n - 1]
            sigma[p] = np.inf


def ratio_sums(longer: Image, shorter: Image, clip: float) -> tuple[float, float, int]:
    """Sums whose ratio is that of two exposures, unbiased: chosen on one green site, measured on the other.

    Parameters
    ----------
    longer, shorter : (2, y, x) float32
        Counts over black of both green sites.
    clip
        Counts over black of saturation.

    Returns
    -------
    longer_sum, shorter_sum : float
        Counts of the sites that are well lit in the longer exposure.
    sites : int
        How many they are.
    """
    sums, sites = np.zeros(2), 0
    for chosen, measured in ((0, 1), (1, 0)):
        use = (longer[chosen] > 0.05 * clip) & (longer[chosen] < 0.8 * clip) & (longer[measured] < 0.97 * clip)
        sums += longer[measured][use].sum(dtype=float), shorter[measured][use].sum(dtype=float)
        sites += int(use.sum())
    return float(sums[0]), float(sums[1]), sites
