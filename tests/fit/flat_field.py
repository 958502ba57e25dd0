"""A flat material under lamps and a camera at finite distances, with and without their positions."""

from pathlib import Path

import numpy as np
from cloth_on_disk import Cloth, directions
from synthetic_texels import grid

from kinran.base import distances
from kinran_bsdf.models import Slope

SIDE, FIELD, DISTANCE = 9, 60.0, 600.0
WIDTH = 0.12


def flat_field(light: np.ndarray, field: float = FIELD, distance: float = DISTANCE) -> np.ndarray:
    """What one flat material of a GGX lobe on a diffuse floor shows under a lamp (y, x, 3), the distances known."""
    points = distances.texel_points(SIDE, SIDE, field / SIDE)
    towards = distances.directions_to(distance * light, points)
    half = towards + distances.directions_to((0, 0, distance), points)
    slopes = half[..., :2] / half[..., 2:]
    lobe = Slope("ggx").of_slopes(slopes[..., 0], slopes[..., 1], 0, 0, WIDTH**2, 0, WIDTH**2)
    colour = lobe[..., None] * [2, 1.5, 0.7] + towards[..., 2:] * [0.1, 0.02, 0.02]
    return colour * distances.falloff(distance * light, points)[..., None]


def flat_cloths(folder: Path, labels: np.ndarray | None = None) -> dict[str, Cloth]:
    """The field under a grid of lamps, every eighth held out: as if they were ``far``, and ``near`` as they are."""
    lights, held = grid(10, 12), 8
    radiance = np.stack([flat_field(light) for light in lights])
    known = directions(lights, DISTANCE, held)
    at = {"texel_mm": FIELD / SIDE, "camera_mm": (0.0, 0.0, DISTANCE)}
    return {
        "far": Cloth(folder / "far", radiance, directions(lights, None, held), labels),
        "near": Cloth(folder / "near", radiance, known, labels, **at),
    }
