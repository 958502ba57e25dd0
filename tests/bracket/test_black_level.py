"""Black levels: by kind of site, with fractions, and under a border that may be lit."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from raw_frames import BLACK, GAIN, RATES, READ, TRUE, scene, write_with_tags

from kinran.__main__ import main
from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.bracket.black_level import site_black
from kinran.bracket.merge import read, timed
from kinran.bracket.uncalibrated import describe
from kinran.data.raw import read_raw
from kinran.virtual.dng import Tags, write_dng
from kinran.virtual.sensor import BORDER, Sensor

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


def test_tags_far_from_what_libraw_reads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths, _ = frames(tmp_path, np.full((2, 2), 253.6), FRACTIONS)
    monkeypatch.setattr("kinran.data.raw.dng_black", lambda *_: np.full(4, 100.0))
    with pytest.raises(InputError, match=r"tags state black levels of \[100.0, .* but LibRaw reads \[253.0, "):
        read_raw(paths[0])


def test_a_crw_that_is_cut_off(tmp_path: Path) -> None:
    """Its directory is at its end."""
    path = tmp_path / "a.crw"
    path.write_bytes(b"II\x1a\0\0\0HEAPCCDR" + bytes(5000))
    with pytest.raises(InputError, match=r"a.crw: cannot be read as RAW \(it is cut off, or of no camera"):
        read_raw(path)


WRONG = {"a fraction lost": ([(50714, "H", 1, 253, True)], np.full((2, 2), 253.6))}
WRONG["the mean of four"] = ([(50714, "2I", 1, (513, 2), True)], np.array([[253.0, 256.0], [256.0, 261.0]]))


@pytest.mark.parametrize("kind", WRONG)
def test_exposures_that_contradict_the_stated_level(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The failure: 253 for 253.6 makes dark cloth 6 % too bright. Exposures agree on 253.6, and are believed."""
    tags, black = WRONG[kind]
    paths, electrons = frames(tmp_path, black, tags)
    assert max(map(abs, bias(tmp_path, paths, electrons).values())) < 0.02
    assert "but the exposures agree on 253." in capsys.readouterr().err


def test_a_level_that_exposures_do_not_contradict_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths, _ = frames(tmp_path, np.full((2, 2), 253.6), FRACTIONS)
    bracket, _ = read(timed(paths, ""), "")
    assert describe([bracket]).black == (253.6,) * 4
    assert "agree" not in capsys.readouterr().err


def test_exposures_far_from_the_stated_level(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths, _ = frames(tmp_path, np.full((2, 2), 256.0), [(50714, "H", 1, 190, True)])
    assert main(["merge", *map(str, paths), "--out", str(tmp_path / "x.exr")]) == 2
    said = capsys.readouterr().err
    assert "f_1-25s.dng: states a black level of 190.0 counts, but its exposures agree on 256." in said


def test_rows_that_drift(tmp_path: Path) -> None:
    """The failure: with one level for all rows, dark rows are off by the drift, 20 counts here, at each exposure."""
    sensor = Sensor(prnu=0, hot=0, dark=0, flicker=0, row_drift=20.0, columns=32)
    light = np.full((200, 120, 3), 1e-4, np.float32)
    light[:, :40] = 0.1
    paths = []
    for k, rate in enumerate(RATES):
        counts = sensor.expose(light, TRUE[rate], 1.0, 0, np.array([k], np.uint64))
        paths.append(tmp_path / f"f_{rate}.dng")
        said = Tags(Fraction(1, rate), BORDER, 256, 4095, "2000:01:01 00:00:00", columns=sensor.columns)
        write_dng(paths[-1], counts, said)
    bracket, _ = read(timed(paths, ""), "")
    black = site_black(bracket, (0.0,) * 4, True)
    assert np.ptp(black, 2).min() > 40
    dark = bracket.planes[-1, 1, :, 45:].mean(1) - sensor.gain**-1 * 1e-4 * sensor.rate * TRUE[4000]
    assert np.std(dark - black[-1, 1]) < 0.3 < 10 < np.std(dark)
