"""Synthetic texels with known lobes."""

import numpy as np

from kinran import frames
from kinran.fit.lobes import squared_widths
from kinran_bsdf import models


def grid(step_theta: float = 5.0, azimuths: int = 24) -> np.ndarray:
    """The paper's grid of lights with fewer azimuths; θ = 0 once."""
    thetas = np.radians(np.arange(step_theta, 80.1, step_theta))
    phis = np.arange(azimuths) * 2 * np.pi / azimuths
    t, p = np.meshgrid(thetas, phis, indexing="ij")
    return np.concatenate([[[0, 0, 1]], frames.direction(t.ravel(), p.ravel())])


def radiance(shapes: np.ndarray, colours: np.ndarray, lights: np.ndarray, tail: str = "ggx") -> np.ndarray:
    """T (texel, 3, light) of one lobe (texel, 7) and colours (texel, 2, 3), by the plugin's definition."""
    s = frames.slopes(lights)
    column = [shapes[:, k, None] for k in range(7)]
    widths = [w[:, None] for w in squared_widths(shapes[:, :5])]
    G = models.slope_lobe(s[:, 0], s[:, 1], column[0], column[1], *widths, tail)
    D = models.diffuse(lights.T, column[5], column[6])
    return (colours[:, 0, :, None] * G[:, None] + colours[:, 1, :, None] * D[:, None]).astype(np.float32)


def texels(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Shapes and colours of facets of gold over silk."""
    rng = np.random.default_rng(seed)
    shapes = np.zeros((count, 7))
    shapes[:, :2] = rng.normal(0, 0.2, (count, 2))
    shapes[:, 2] = -np.log(rng.uniform(0.1, 0.3, count))
    shapes[:, 3] = rng.normal(0, 2, count)
    shapes[:, 4] = -np.log(rng.uniform(0.1, 0.3, count))
    shapes[:, 5:] = rng.normal(0, 0.1, (count, 2))
    colours = np.stack(
        [rng.uniform(1, 3, (count, 1)) * [1, 0.75, 0.35], rng.uniform(0.05, 0.2, (count, 1)) * [1, 0.1, 0.1]], 1
    )
    return shapes, colours
