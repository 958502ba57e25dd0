"""A small trial: shiny cloth of two regions under lights on a grid."""

from dataclasses import replace

import numpy as np

from kinran.base.frames import direction
from kinran.compare.trial import Trial
from kinran.data.radiance_stack import Light
from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

SHAPE = (9, 12)


def shiny_trial(seed: int = 0) -> Trial:
    """Nine by twelve texels under a 5 × 12 grid, every fourth light held out; a slope lobe on a cosine."""
    grid = np.array([(i, k) for i in range(1, 6) for k in range(12)])
    lights = direction(np.radians(14.0 * grid[:, 0]), np.radians(30.0 * grid[:, 1]))
    rng = np.random.default_rng(seed)
    texels = SHAPE[0] * SHAPE[1]
    region = (np.arange(texels) % SHAPE[1] >= 6).astype(np.intp)
    s = lights[:, :2] / (1 + lights[:, 2:])
    centre = rng.uniform(-0.1, 0.1, (texels, 2))
    q = ((s[None] - centre[:, None]) ** 2).sum(-1) / np.where(region == 0, 0.25, 0.4)[:, None] ** 2
    lobe = np.where(region == 0, 3.0, 0.5)[:, None] / (1 + q) ** 2
    colour = np.array([[1.0, 0.8, 0.3], [0.5, 0.05, 0.05]])[region]
    T = (colour[:, :, None] * (lobe[:, None] + 0.2 * lights[:, 2])).astype(np.float32)
    held = grid.sum(1) % 4 == 0
    weights = np.ones((texels, int((~held).sum())), np.float32)
    return Trial(
        samples=Samples.far(np.ascontiguousarray(T[:, :, ~held]), weights, lights[~held], region),
        lights=tuple(
            Light(f"{i} {k}", tuple(lights[n]), grid=(int(i), int(k))) for n, (i, k) in enumerate(grid) if not held[n]
        ),
        held=Under.far(lights[held], texels),
        truth=np.ascontiguousarray(T[:, :, held]),
        valid=np.ones((texels, 3, int(held.sum())), bool),
        full=np.zeros((texels, 3, int(held.sum())), bool),
        share=np.sqrt(1 - lights[held, 2] ** 2),
        regions=("gold", "red"),
        shape=SHAPE,
        coder=None,
        peak=float(np.percentile(T, 99.9)),
        clips=(np.full(3, 0.4), np.full(3, 1.6), np.full(3, 6.4)),
        to_rec709=np.eye(3),
    )


def with_samples(trial: Trial, **parts: np.ndarray) -> Trial:
    """The trial with other parts of its training samples: T, W, region, second."""
    return replace(trial, samples=replace(trial.samples, **parts))
