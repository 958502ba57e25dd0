"""Brackets of RAW files of a scene whose light is known."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import tifffile

from kinran.virtual.dng import RGGB, Tags, write_dng

RATES = (25, 100, 250, 1000, 4000)
TRUE = {rate: 2.0 ** (-n / 3) for rate, n in zip(RATES, (14, 20, 24, 30, 36), strict=True)}
GAIN, READ, BLACK, CLIP = 1 / 12.1, 20 / 12.1, 256, 3726
MASK = 8


def scene(side: int = 64, seed: int = 0) -> np.ndarray:
    """Electrons a second (2 side, 2 side) of a mosaic, top row first: smooth in patches, over five decades."""
    rng = np.random.default_rng(seed)
    patches = 10 ** rng.uniform(3.5, 7.9, (side // 8, side // 8))
    return np.kron(patches, np.ones((16, 16)))


def expose(
    electrons: np.ndarray, seconds: float | np.ndarray, rng: np.random.Generator, full: int = CLIP
) -> np.ndarray:
    """Counts of a 12-bit sensor."""
    mean = electrons * seconds
    counts = (rng.normal(mean, np.sqrt(mean)) + rng.normal(0, READ / GAIN, mean.shape)) * GAIN + BLACK
    return np.clip(np.floor(counts + 0.5), 0, full).astype(np.uint16)


def write(path: Path, counts: np.ndarray, rate: int, mask: int = MASK, **tags: object) -> Path:
    """Write a DNG whose first rows are under a mask (counts of darkness), under its nominal time."""
    rng = np.random.default_rng(rate)
    dark = np.floor(rng.normal(BLACK, READ, (mask, counts.shape[1])) + 0.5).astype(np.uint16)
    whole = np.concatenate([dark, counts])
    values: dict[str, object] = {"black": BLACK, "white": 4095, "when": "2000:01:01 00:00:00", "pattern": RGGB, **tags}
    write_dng(path, whole, Tags(Fraction(1, rate), mask, **values))  # type: ignore[arg-type]
    return path


def bracket(folder: Path, electrons: np.ndarray, seed: int = 1, rates: tuple[int, ...] = RATES) -> list[Path]:
    """A bracket of the scene, longest exposure first."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    return [write(folder / f"f_{rate}.dng", expose(electrons, TRUE[rate], rng), rate) for rate in rates]


def write_with_tags(path: Path, counts: np.ndarray, tags: list[tuple[int, str, int, object, bool]]) -> Path:
    """Write counts (all of the sensor) as a DNG with tags of one's own, such as fractions of a black level."""
    own = {number for number, *_ in tags}
    height, width = counts.shape
    usual: list[tuple[int, str, int, object, bool]] = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True),
        (50707, "B", 4, bytes([1, 1, 0, 0]), True),
        (50708, "s", 0, "Kinran test", True),
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, bytes(RGGB), True),
        (50829, "I", 4, (0, 0, height, width), True),
        (50717, "H", 1, 4095, True),
    ]
    extra = [tag for tag in usual if tag[0] not in own] + tags
    tifffile.imwrite(path, counts, photometric=32803, extratags=extra, metadata=None, software=None)
    return path
