"""Small pictures of a set, from which its encoding and the axes of its lights are judged."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinran.base.distances import relative_light
from kinran.base.log import progress
from kinran.data.capture_plan import Plan
from kinran.data.colour_profile import is_srgb, to_linear
from kinran.data.photographs import CLIPPED, Crop, parse_crop
from kinran.data.picture_file import read_picture
from kinran.data.picture_kind import is_raw
from kinran.data.raw import read_raw

Array = NDArray[np.float64]

MOST_LIGHTS = 48
"""Most lights of a set that are looked at: a choice, so that a large dome does not take long."""
SIDE = 128
"""Most blocks along a side of a picture. A choice: means of blocks have little noise, and still show relief."""
LIT = 0.1
"""Share of the brightness of the brightest blocks under which a block may be background. A choice."""


@dataclass(frozen=True)
class SampledSet:
    """Means over blocks of the photographs of a set.

    Attributes
    ----------
    codes : (light, y, x) float
        Means of R, G, B, 1 for white; light where the files tell how to get it; the top row first.
    clipped : (light, y, x) bool
        Where a block has a sample at white.
    directions : (light, 3) float
        Unit vectors to the lights.
    gains : (light,) float
        Light of each lamp relative to the others, as far as intensities and distances are stated.
    linear
        Whether the files say that the values are linear light, or tell how they became so.
    """

    codes: Array
    clipped: NDArray[np.bool_]
    directions: Array
    gains: Array
    linear: bool = False

    @property
    def lit(self) -> NDArray[np.bool_]:
        """Blocks (y, x) that are no background."""
        mean = self.codes.mean(0)
        return np.asarray(mean > LIT * np.quantile(mean, 0.99))


def sample(plan: Plan, paths: Sequence[Path]) -> SampledSet:
    """Sample up to `MOST_LIGHTS` photographs of a set, evenly over its list.

    Parameters
    ----------
    plan
        Plan of the set.
    paths
        A photograph of each light, in the plan's order.

    Raises
    ------
    InputError
        A photograph cannot be read.
    """
    chosen = np.unique(np.linspace(0, len(paths) - 1, min(MOST_LIGHTS, len(paths))).round().astype(int))
    crop = parse_crop(plan.crop)
    pictures = [_blocks(paths[k], crop) for k in progress(list(chosen), "look", "photographs")]
    codes = np.stack([means for means, _, _ in pictures])
    lights = [plan.lights[k] for k in chosen]
    gains = np.array([np.mean(light.intensity) if light.intensity else 1.0 for light in lights])
    positions = [light.position_mm for light in lights if light.position_mm]
    if len(positions) == len(lights):
        gains = gains * relative_light(positions)
    linear = all(linear for _, _, linear in pictures)
    return SampledSet(
        codes / np.quantile(codes, 0.99) if linear else codes,  # floating point has no white
        np.stack([clipped for _, clipped, _ in pictures]),
        np.array([light.direction for light in lights]),
        gains / gains.mean(),
        linear,
    )


def _blocks(path: Path, crop: Crop | None) -> tuple[Array, NDArray[np.bool_], bool]:
    """Return the means (y, x) of a photograph's blocks, which have a sample at white, and whether they are linear."""
    values, white, profile = _values(path)
    if crop:
        values = values[crop.y : crop.y + crop.height, crop.x : crop.x + crop.width]
    step = -(-max(values.shape[:2]) // SIDE)
    height, width = values.shape[0] // step, values.shape[1] // step
    parts = values[: height * step, : width * step].reshape(height, step, width, step, -1)
    clipped = parts.max((1, 3, 4)) >= CLIPPED * (white or np.inf)
    means = parts.mean((1, 3), dtype=np.float32) / np.float32(white or 1)
    stated = bool(profile) and not is_srgb(profile)
    if stated:
        means = to_linear(means, profile)
    return means.mean(-1, dtype=float), clipped, stated or not white or is_raw(path)


def _values(path: Path) -> tuple[NDArray[np.generic], float, bytes]:
    """Return R, G, B (y, x, 3) of a photograph as it is shown, or green of a RAW file; white, or 0; and its profile."""
    if not is_raw(path):
        picture = read_picture(path)
        return picture.values, picture.ceiling, picture.profile
    raw = read_raw(path).upright()
    black = float(raw.black[1:3].mean())
    green = raw.planes[1:3, ::-1].astype(np.float32).mean(0) - np.float32(black)
    return np.maximum(green, 0)[..., None], raw.white - black, b""
