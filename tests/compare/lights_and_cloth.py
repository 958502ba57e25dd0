"""Light directions and synthetic samples for the baselines."""

import numpy as np

from kinran.base.frames import direction
from kinran.data.texel_directions import Under
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples


def spiral(count: int, theta_max: float = 80.0) -> np.ndarray:
    """Directions (count, 3) that cover the cap evenly (golden angle)."""
    k = np.arange(count) + 0.5
    cosine = 1 - (1 - np.cos(np.radians(theta_max))) * k / count
    return direction(np.arccos(cosine), np.pi * (1 + 5**0.5) * k)


def shiny(texels: int, lights: np.ndarray, seed: int = 0) -> np.ndarray:
    """Smooth but lobed samples (texel, 3, light) float32: a Gaussian in slopes on a cosine."""
    rng = np.random.default_rng(seed)
    s = lights[:, :2] / (1 + lights[:, 2:])
    centre = rng.uniform(-0.3, 0.3, (texels, 2))
    q = ((s[None] - centre[:, None]) ** 2).sum(-1) / 0.25**2
    colour = rng.uniform(0.2, 1.0, (texels, 3))
    T = colour[:, :, None] * np.exp(-q)[:, None] + 0.3 * colour[:, ::-1, None] * lights[:, 2]
    return T.astype(np.float32)


def given(T: np.ndarray, lights: np.ndarray, W: np.ndarray | None = None) -> Samples:
    """Samples under lights that are far away; all count alike by default."""
    return Samples.far(T, np.ones(T.shape[::2], np.float32) if W is None else W, lights)


def said(fitted: Fitted, lights: np.ndarray) -> np.ndarray:
    """What a fit says under lights that are far away."""
    return fitted.predict(Under.far(lights))


def relative(predicted: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(((predicted - truth) ** 2).sum() / (truth**2).sum()))
