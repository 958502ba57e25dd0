"""Errors of predictions on held-out samples, in the measures of the chart."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from kinran.compare.trial import Trial
from kinran.data import metrics
from kinran.data.metrics import LOG_COMPRESSION

Array = NDArray[np.float64]
Single = NDArray[np.float32]

SSIM_SIGMA, SSIM_K1, SSIM_K2 = 1.5, 0.01, 0.03
"""Window, in texels, and constants of [Wang2004]."""
SSIM_LIGHTS = 24
"""Most held-out lights whose images are compared by SSIM, which takes longer than all other measures. A choice."""
BANDS = (0, 30, 50, 65, 90)
"""Bounds of the bands of θ, degrees. A choice."""
EXACT = 1e-10
"""Share of the samples' mean square below which a residual is rounding: float32 is rounded to 6e-8 of a value."""


def squares(predicted: Single, trial: Trial) -> tuple[Array, Array]:
    """Weighted squared errors and energies (texel, light) of a prediction (texel, 3, light), summed over channels."""
    w = trial.share * trial.valid
    difference = trial.allowed(predicted).astype(float) - trial.truth
    return (w * difference**2).sum(1), (w * trial.truth.astype(float) ** 2).sum(1)


def summary(predicted: Single, trial: Trial) -> dict[str, float]:
    """All measures of a prediction (texel, 3, light) on the held-out lights.

    `relative_error` √(Σ w e² / Σ w g²) in the stack's RGB; `log_error` the mean |ln((m + ε) / (g + ε))| with
    ε = p99.9 / 500, about a relative error that weighs dark samples like bright ones; `texel_p95` and
    `texels_above_1` of the relative error by texel; PSNR and SSIM of linear Rec. 709 up to p99.9 and of display
    values (the encoding of photographs; log-compressed radiance).
    """
    e, g = squares(predicted, trial)
    by_texel = np.sqrt(e.sum(1) / np.maximum(g.sum(1), 1e-12))
    floor = trial.peak / LOG_COMPRESSION
    ratio = (np.maximum(trial.allowed(predicted), 0) + floor) / (np.maximum(trial.truth, 0) + floor)
    valid = trial.valid.sum() or 1
    return {
        "relative_error": ratio_of(e, g),
        "log_error": float((np.abs(np.log(ratio)) * trial.valid).sum() / valid),
        "texel_median": float(np.median(by_texel)),
        "texel_p95": float(np.percentile(by_texel, 95)),
        "texels_above_1": float((by_texel > 1).mean()),
        **pictures(predicted, trial),
    }


def criteria(fitted: Single, trial: Trial, numbers: float) -> dict[str, float]:
    """Akaike's and Schwarz's criteria, n ln(RSS / n) + 2 k and + k ln n, mean over texels; less is better.

    Both take the residual of a model for noise, which it is not. A model that goes through its samples has none.

    Parameters
    ----------
    fitted : (texel, 3, light) float32
        T that the model predicts of the training samples.
    numbers
        Numbers k of a texel.
    """
    samples = trial.samples
    used = samples.W[:, None] > 0
    left = np.where(used, fitted - samples.T, 0).astype(float)
    energy = float(np.mean(samples.T.astype(float) ** 2))
    n = np.maximum(3.0 * used.sum((1, 2)), 1)
    rss = (left**2).sum((1, 2)) / n
    if not energy > 0 or np.median(rss) < EXACT * energy:
        return {}
    misfit = n * np.log(np.maximum(rss, EXACT * energy))
    return {"aic": float(np.mean(misfit + 2 * numbers)), "bic": float(np.mean(misfit + numbers * np.log(n)))}


def ratio_of(e: Array, g: Array) -> float:
    """Relative error of squared errors and energies."""
    return float(np.sqrt(e.sum() / max(g.sum(), 1e-30)))


def by_band(predicted: Single, trial: Trial) -> dict[str, float]:
    """Relative error by θ of the light, in the bands of `BANDS` that hold lights."""
    e, g = squares(predicted, trial)
    theta = np.degrees(np.arccos(np.clip(trial.held.directions[:, 2], -1, 1)))
    result = {}
    for low, high in pairwise(BANDS):
        inside = (theta >= low) & (theta < high)
        if inside.any():
            result[band(low, high)] = ratio_of(e[:, inside], g[:, inside])
    return result


def band(low: int, high: int) -> str:
    """Name of a band of θ, degrees."""
    return f"{low}–{high}°"


def by_region(predicted: Single, trial: Trial) -> dict[str, float]:
    """Relative error of each region that the trial has texels of."""
    e, g = squares(predicted, trial)
    inside = {name: trial.samples.region == k for k, name in enumerate(trial.regions)}
    return {name: ratio_of(e[at], g[at]) for name, at in inside.items() if at.any()}


def psnr(predicted: Single, trial: Trial) -> Array:
    """PSNR (light,), in dB, of displayed values in the stack's RGB, as `kinran evaluate` computes it."""
    seen = trial.allowed(predicted)
    p, g, v = (np.moveaxis(a, -1, 0) for a in (seen, trial.truth, trial.valid.astype(np.float32)))
    shown = [metrics.to_display(a, trial.coder, trial.peak) for a in (p, g)]
    return np.array([metrics.psnr(*of_light) for of_light in zip(*shown, v, strict=True)])


def pictures(predicted: Single, trial: Trial) -> dict[str, float]:
    """PSNR and SSIM in linear and in display values; empty for a trial whose texels are no whole picture."""
    height, width = trial.shape
    if height * width != trial.texels:
        return {}
    seen = np.where(trial.valid, trial.allowed(predicted), trial.truth)
    m, g = (np.einsum("cd,tdl->tcl", trial.to_rec709.astype(np.float32), a) for a in (seen, trial.truth))
    result = {}
    display = [metrics.to_display(light, trial.coder, trial.peak) for light in (m, g)]
    for name, (a, b) in (("linear", (m / trial.peak, g / trial.peak)), ("display", display)):
        a, b = np.clip(a, 0, 1), np.clip(b, 0, 1)
        all_count = np.ones(a.shape[1::-1], np.float32)
        result[f"psnr_{name}"] = float(np.mean([metrics.psnr(*pair, all_count) for pair in zip(a.T, b.T, strict=True)]))
        use = np.linspace(0, a.shape[2] - 1, min(SSIM_LIGHTS, a.shape[2])).astype(int)
        images = [(a[:, c, i].reshape(height, width), b[:, c, i].reshape(height, width)) for i in use for c in range(3)]
        result[f"ssim_{name}"] = float(np.mean([ssim(x, y) for x, y in images]))
    return result


def ssim(a: Single, b: Single) -> float:
    """Mean structural similarity of two images (y, x) in [0, 1] (Wang2004, Eq. 13), Gaussian window of σ = 1.5."""
    a, b = a.astype(float), b.astype(float)
    c1, c2 = SSIM_K1**2, SSIM_K2**2
    ma, mb = gaussian_filter(a, SSIM_SIGMA), gaussian_filter(b, SSIM_SIGMA)
    va = gaussian_filter(a * a, SSIM_SIGMA) - ma * ma
    vb = gaussian_filter(b * b, SSIM_SIGMA) - mb * mb
    cov = gaussian_filter(a * b, SSIM_SIGMA) - ma * mb
    return float(np.mean((2 * ma * mb + c1) * (2 * cov + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))))
