"""Errors of a prediction on the held-out lights, summed tile by tile: by region, by light and by texel."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.data import metrics
from kinran.data.held_out_photographs import HeldOut, Survey
from kinran.data.labels import Region

Images = NDArray[np.float32]

BRIGHTER = 2
"""Times its photograph that a relit texel above white counts as too bright. A choice: noise and a lobe that is somewhat
off stay below it."""


class Tally:
    """Squared errors of a prediction, summed over the tiles of a fabric.

    Parameters
    ----------
    seen
        Survey of the held-out photographs.
    regions
        Regions of the fabric.
    """

    def __init__(self, seen: Survey, regions: list[Region]) -> None:
        self._lights, self._share, self._regions = seen.lights, seen.share, regions
        shape = (len(seen.lights), 1 + len(regions))  # over all texels, then over those of each region
        self._shown, self._sound, self._error, self._energy = (np.zeros(shape) for _ in range(4))
        self._texels: list[Images] = []
        self._white: list[NDArray[np.bool_]] = []

    def add(self, held: HeldOut, predicted: Images, labels: NDArray[np.integer]) -> None:
        """Add the prediction (light, y, x, 3) of a tile, and the labels (texel,) of its texels."""
        inside = np.stack([np.ones(labels.shape), *(labels == region.label for region in self._regions)], -1)
        valid, truth, allowed = held.valid, held.truth, held.allowed(predicted)
        shown = valid * (held.shown(allowed).astype(float) - held.shown(truth)) ** 2
        error, energy = valid * (allowed.astype(float) - truth) ** 2, valid * truth.astype(float) ** 2
        by_texel = [values.sum(-1, dtype=float).reshape(len(values), -1) for values in (shown, valid, error, energy)]
        for total, values in zip((self._shown, self._sound, self._error, self._energy), by_texel, strict=True):
            total += values @ inside
        white = (valid > 0) & (predicted > np.maximum(1, BRIGHTER * truth))
        wrong, bright = (self._share @ values for values in by_texel[2:])
        known = by_texel[1].any(0)
        self._white.append(white.any((0, -1)).reshape(-1)[known])
        self._texels.append(np.sqrt(wrong / np.maximum(bright, 1e-12)).astype(np.float32)[known])

    def errors(self) -> dict[str, Any]:
        """Return the errors over all texels and lights, by texel, by region and by light."""
        decibels = metrics.decibels(self._shown / np.maximum(self._sound, 1))

        def over(k: int) -> dict[str, float]:
            return {
                "relative_error": _relative(
                    float(self._share @ self._error[:, k]), float(self._share @ self._energy[:, k])
                ),
                "psnr": round(float(decibels[:, k].mean()), 3),
                "psnr_min": round(float(decibels[:, k].min()), 3),
            }

        texels, white = np.concatenate(self._texels), np.concatenate(self._white)
        if not len(texels):  # no sample is sound: nothing is known to be wrong
            texels, white = np.zeros(1, np.float32), np.zeros(1, bool)
        return {
            **over(0),
            "texel_median": round(float(np.median(texels)), 5),
            "texel_p95": round(float(np.percentile(texels, 95)), 5),
            "texels_above_1": round(float((texels > 1).mean()), 6),
            "texels_above_white": round(float(white.mean()), 6),
            "regions": {r.name: {**over(k), "texels": r.texels} for k, r in enumerate(self._regions, 1)},
            "lights": {
                light.name: {
                    "psnr": round(float(decibels[i, 0]), 3),
                    "relative_error": _relative(self._error[i, 0], self._energy[i, 0]),
                }
                for i, light in enumerate(self._lights)
            },
        }


def _relative(error: float, energy: float) -> float:
    """Return the relative error √(Σ w (m − g)² / Σ w g²) of two sums; 0 where nothing was sound."""
    return round(float(np.sqrt(error / energy)), 5) if energy > 0 else 0.0
