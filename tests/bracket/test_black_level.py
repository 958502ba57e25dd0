"""Black levels: by kind of site, with fractions, and under a border that may be lit."""

from pathlib import Path

import numpy as np
import pytest
from raw_frames import BLACK, GAIN, RATES, READ, TRUE, scene, write_with_tags

from kinran.__main__ import main
from kinran.base.exr import read_exr
from kinran.data.raw import read_raw

SITES = {"R": (0, 0), "G1": (0, 1), "G2": (1, 0), "B": (1, 1)}
DARK = 3e3
"""Electrons a second of dark cloth, of which a black level that is one count off takes or gives a tenth at 1/25 s."""


def frames(
    folder: Path, black: np.ndarray, tags: list[tuple[int, str, int, object, bool]], border: float | None = None
) -> tuple[list[Path], np.ndarray]:
    """A bracket of a bright and a dark half, with a black level (2, 2) for each kind of site and, maybe, a border.

    The border has 16 rows that see `border` electrons a second, 0 under a mask.
    """
    electrons = scene(64)
    electrons[:, :64] = DARK
    rng = np.random.default_rng(3)
    shift = np.tile(black - BLACK, np.array(electrons.shape) // 2)
    paths = []
    for rate in RATES:
        counts = expose_with(electrons, TRUE[rate], shift, rng)
        if border is not None:
            seen = np.full((16, counts.shape[1]), border)
            counts = np.concatenate([expose_with(seen, TRUE[rate], shift[:16], rng), counts])
        paths.append(write_with_tags(folder / f"f_1-{rate}s.dng", counts, tags))
    return paths, electrons


def expose_with(electrons: np.ndarray, seconds: float, shift: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Counts with a black level that is a fraction: dither by the read noise makes its mean right."""
    mean = electrons * seconds
    counts = rng.normal(mean, np.sqrt(mean)) * GAIN + rng.normal(0, READ, mean.shape) + BLACK + shift
    return np.clip(np.floor(counts + 0.5), 0, 3726).astype(np.uint16)


def bias(folder: Path, paths: list[Path], electrons: np.ndarray) -> dict[str, float]:
    """Relative error of dark cloth, by colour."""
    assert main(["merge", *map(str, paths), "--out", str(folder / "x.exr")]) == 0
    merged = read_exr(folder / "x.exr")
    dark = np.zeros(merged["R"].shape, bool)
    dark[:, :30] = True
    return {name: float(merged[name][dark].mean() / (DARK * GAIN) - 1) for name in "RGB"}


FRACTIONS = [(50714, "2I", 1, (6340, 25), True)]
BY_SITE = [(50713, "H", 2, (2, 2), True), (50714, "H", 4, (253, 256, 256, 261), True)]
BY_ROW = [(50714, "H", 1, 254, True), (50716, "2i", 128, [0, 1, 4, 1] * 64, True)]


@pytest.mark.parametrize(
    ("black", "tags"),
    [
        pytest.param(np.full((2, 2), 253.6), FRACTIONS, id="a fraction"),
        pytest.param(np.array([[253, 256], [256, 261]]), BY_SITE, id="by kind of site"),
        pytest.param(np.array([[254, 254], [258, 258]]), BY_ROW, id="by row"),
    ],
)
def test_what_a_dng_states(tmp_path: Path, black: np.ndarray, tags: list[tuple[int, str, int, object, bool]]) -> None:
    """To 0.05 counts, and dark cloth to 2 %."""
    paths, electrons = frames(tmp_path, black, tags)
    stated = read_raw(paths[0]).black
    np.testing.assert_allclose(stated, [black[site] for site in SITES.values()], atol=0.05)
    assert max(map(abs, bias(tmp_path, paths, electrons).values())) < 0.02


def test_a_masked_border_tells_the_level_of_each_kind_of_site(tmp_path: Path) -> None:
    """Rows of G2 and B lie three counts higher than the file says."""
    black = np.array([[256, 256], [259, 259]])
    tags = [(50829, "I", 4, (16, 0, 144, 128), True), (50714, "H", 1, BLACK, True)]
    paths, electrons = frames(tmp_path, black, tags, border=0)
    assert max(map(abs, bias(tmp_path, paths, electrons).values())) < 0.03


def test_a_border_that_light_reaches_is_no_mask(tmp_path: Path) -> None:
    """It brightens with the exposure time; taken for dark it would leave nothing of dark cloth."""
    tags = [(50829, "I", 4, (16, 0, 144, 128), True), (50714, "H", 1, BLACK, True)]
    paths, electrons = frames(tmp_path, np.full((2, 2), 256.0), tags, border=DARK)
    assert max(map(abs, bias(tmp_path, paths, electrons).values())) < 0.02


def test_a_border_far_from_the_stated_level(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tags = [(50829, "I", 4, (16, 0, 144, 128), True), (50714, "H", 1, 100, True)]
    paths, _ = frames(tmp_path, np.full((2, 2), 256.0), tags, border=0)
    assert main(["merge", *map(str, paths), "--out", str(tmp_path / "x.exr")]) == 2
    assert "dark border has 256.0 counts, but the file states a black level of 100.0" in capsys.readouterr().err
