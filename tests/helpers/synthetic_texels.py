"""Synthetic texels with known lobes, for the tests: those of `kinran bench stability`."""

import numpy as np

from benchmarks.texels import grid, radiance, texels
from kinran.fit.samples import Samples

__all__ = ["grid", "radiance", "sampled", "texels"]


def sampled(T: np.ndarray, lights: np.ndarray, W: np.ndarray | None = None) -> Samples:
    """Samples (texel, 3, light) under lights (light, 3) that are far away; without weights all count alike."""
    return Samples.far(T, np.ones((len(T), len(lights)), np.float32) if W is None else W, lights)
