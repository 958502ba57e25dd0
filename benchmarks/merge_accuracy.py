"""Accuracy of merging against the Cramér–Rao bound, on a synthetic 12-bit camera, beside other estimators."""

import importlib
import importlib.metadata
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, poisson

from kinran.bracket.estimator import estimate
from kinran.bracket.response_curve import Curve, merge_debevec
from kinran.data.calibration import Response

Array = NDArray[np.float64]

SECONDS = 2.0 ** (-np.array([14, 20, 24, 30, 36]) / 3)
"""1/25 to 1/4000 s, as third stops."""
BLACK, CLIP, GAIN, READ = 256, 3726, 1 / 12.1, 20.0
"""Synthetic camera: count of darkness, count of saturation, counts per electron, read noise in electrons. Choices."""
RESPONSE = Response(CLIP - BLACK, GAIN, float(np.hypot(READ * GAIN, 12**-0.5)))
"""Response of the synthetic camera that the estimators are given: read noise and rounding together."""
DECADES = (3, 4, 5, 6, 7)
"""Logarithms of the electrons a second at which decades begin."""
BRIGHTEST = 8.05
"""Logarithm of the electrons a second of the brightest level, a little under what saturates the shortest exposure."""


def expose(rates: Array, rng: np.random.Generator) -> NDArray[np.uint16]:
    """Counts (exposure, …) of sites that collect `rates` (…) electrons a second."""
    mean = rates * SECONDS.reshape(-1, *[1] * rates.ndim)
    counts = (rng.poisson(mean) + rng.normal(0, READ, mean.shape)) * GAIN + BLACK
    return np.clip(np.floor(counts + 0.5), 0, CLIP).astype(np.uint16)


def bound(rate: float) -> float:
    """Cramér–Rao bound on the relative standard deviation, exact for shot, read and rounding noise and clipping."""
    information = 0.0
    for seconds in SECONDS:
        step = 1e-4 * rate
        low, middle, high = (_distribution((rate + d) * seconds, rate * seconds) for d in (-step, 0.0, step))
        use = middle > 1e-14
        information += float((((high - low)[use] / (2 * step)) ** 2 / middle[use]).sum())
    return float(1 / (np.sqrt(information) * rate))


def _distribution(electrons: float, around: float) -> Array:
    """Probability of each count from 0 to CLIP."""
    edges = np.arange(CLIP) + 0.5
    if around < 400:
        n = np.arange(int(around + 12 * np.sqrt(around + 1) + 20))
        edges = np.arange(BLACK - 20, min(BLACK + 20 + n[-1] * GAIN, CLIP)) + 0.5  # nothing lies outside
        below = poisson.pmf(n, electrons) @ norm.cdf((edges - BLACK - n[:, None] * GAIN) / (READ * GAIN))
    else:
        spread = np.sqrt(electrons + READ**2) * GAIN
        below = norm.cdf((edges - BLACK - electrons * GAIN) / spread)
    return np.diff(np.concatenate([[0.0], below, [1.0]]))


def measure(sites: int) -> dict[str, Any]:
    """Bias, efficiency and calibration of σ of each estimator, per decade of electrons a second.

    Parameters
    ----------
    sites
        Sensor sites at each level; there are 20 levels in a decade.
    """
    rng = np.random.default_rng(1)
    levels = np.arange(DECADES[0], BRIGHTEST, 0.05)
    rates = np.repeat(10 ** levels[:, None], sites, 1)
    counts = expose(rates, rng)
    bounds = np.array([bound(10**level) for level in levels])
    found: dict[str, Any] = {
        "crb": _by_decade(levels, lambda m: {"percent": 100 * float(np.sqrt(np.mean(bounds[m] ** 2)))})
    }
    notes: dict[str, str] = {}
    for name, estimator in ESTIMATORS.items():
        try:
            value, sigma = estimator(counts)
        except ImportError:
            notes[name] = "not installed"
            continue
        found[name] = _by_decade(levels, lambda m, v=value, s=sigma: _errors(v[m], s, rates[m], bounds[m], m))  # type: ignore[misc]
    return {"sites_per_level": sites, "estimators": found, "left_out": notes}


def _by_decade(levels: Array, of: Callable[[NDArray[np.bool_]], dict[str, float]]) -> dict[str, dict[str, float]]:
    return {f"1e{d}": of((levels > d - 1e-9) & (levels < d + 1 - 1e-9)) for d in DECADES}


def _errors(value: Array, sigma: Array | None, rates: Array, bounds: Array, use: NDArray[np.bool_]) -> dict[str, float]:
    ratio = value / rates
    finite = np.isfinite(ratio)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        ratio = np.where(finite, ratio, np.nan)
        bias = np.nanmean(ratio, 1) - 1
        rmse = np.sqrt(np.nanmean((ratio - 1) ** 2, 1))
    kept = np.isfinite(rmse)
    result = {
        "bias_percent": 100 * float(np.nanmean(bias)),
        "worst_bias_percent": 100 * float(np.nanmax(np.abs(bias))),
        "rmse_over_crb": float(np.mean(rmse[kept] / bounds[kept])),
        "not_finite_percent": 100 * float((~finite).mean()),
    }
    if sigma is not None:
        result["z_rms"] = float(np.sqrt(np.nanmean(np.where(finite, (value - rates) / sigma[use], np.nan) ** 2)))
    return result


def _kinran(counts: NDArray[np.uint16]) -> tuple[Array, Array]:
    merged = estimate(counts, np.full(len(counts), float(BLACK)), SECONDS, RESPONSE)
    return merged.rate.astype(float) / GAIN, merged.sigma.astype(float) / GAIN


def _poisson_sum(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """Estimator of HDRutils [Hanji2020]: the sum of the counts over the sum of the times of what is not saturated."""
    open_ = counts < 0.98 * CLIP
    open_[-1] = True
    y = counts - float(BLACK)
    seconds = SECONDS[:, None, None]
    return (open_ * y).sum(0) / (open_ * seconds).sum(0) / GAIN, None


def _own_value(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """Weighted mean with weights from the noisy values themselves."""
    y, seconds = counts - float(BLACK), SECONDS[:, None, None]
    w = seconds**2 / (np.maximum(y, 0) * GAIN + RESPONSE.read**2) * (y < RESPONSE.clip)
    return (w * y / seconds).sum(0) / np.maximum(w.sum(0), 1e-30) / GAIN, None


def _hat(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """Weighted mean of linear values with the hat weights of Debevec1997."""
    y, seconds = counts - float(BLACK), SECONDS[:, None, None]
    z = y / (CLIP - BLACK)
    w = np.clip(1 - np.abs(2 * z - 1), 0, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return (w * y / seconds).sum(0) / w.sum(0) / GAIN, None


def _debevec(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """Kinran's merge after Debevec1997, on 8 bits, with the true response."""
    codes = np.clip(np.round((counts - float(BLACK)) / (CLIP - BLACK) * 255), 0, 255).astype(np.uint8)
    linear = Curve(tuple(float(v) for v in np.arange(256) / 255))
    return merge_debevec(codes, SECONDS, linear).astype(float) * ((CLIP - BLACK) / GAIN), None


def _opencv(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """OpenCV's MergeDebevec on 16 bits; it has no scale of its own."""
    import cv2

    images = [np.repeat(image[..., None], 3, -1) for image in sixteen_bit(counts)]
    value = cv2.createMergeDebevec().process(images, SECONDS.astype(np.float32))[..., 0].astype(float)
    return _scaled(value, counts), None


def _colour_hdri(counts: NDArray[np.uint16]) -> tuple[Array, None]:
    """Estimate of colour-hdri, shortest exposure first: the only order in which it is right."""
    hdri: Any = importlib.import_module("colour_hdri")
    metadata: Any = importlib.import_module("colour_hdri.utilities").Metadata
    stack = hdri.ImageStack()
    for k in np.argsort(SECONDS):
        image = hdri.Image()
        image.data = np.clip((counts[k] - float(BLACK)) / (CLIP - BLACK), 0, None)[..., None] * np.ones(3)
        image.metadata = metadata(f_number=8.0, exposure_time=float(SECONDS[k]), iso=100.0)
        stack.append(image)
    return _scaled(hdri.image_stack_to_HDRI(stack, hdri.weighting_function_Debevec1997)[..., 0], counts), None


def _scaled(value: Array, counts: NDArray[np.uint16]) -> Array:
    """Values in electrons a second, scaled by the median of the well exposed sites."""
    ours, _ = _kinran(counts)
    middle = (ours > 1e5) & (ours < 3e6)
    return value * float(np.median(ours[middle] / value[middle]))


def sixteen_bit(counts: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Counts as 16-bit values over black, as OpenCV takes them."""
    return (np.clip((counts - np.float32(BLACK)) / (CLIP - BLACK), 0, 1) * 65535 + 0.5).astype(np.uint16)


ESTIMATORS: dict[str, Callable[[NDArray[np.uint16]], tuple[Array, Array | None]]] = {
    "kinran": _kinran,
    "Poisson sum (HDRutils)": _poisson_sum,
    "inverse variance, own value": _own_value,
    "hat weights, linear": _hat,
    "Debevec-Malik, 8 bit": _debevec,
    "OpenCV MergeDebevec, 16 bit": _opencv,
    "colour-hdri Debevec": _colour_hdri,
}
