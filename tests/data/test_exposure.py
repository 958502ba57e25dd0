"""How a RAW file was exposed: from its EXIF without decoding it, and from LibRaw where there is none."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from kinran.data import raw
from kinran.data.nominal_time import exposure_of
from kinran.virtual.dng import Tags, write_dng


@pytest.fixture
def frame(tmp_path: Path) -> Path:
    said = Tags(Fraction(1, 250), 0, 128, 4095, "2026:11:28 12:00:00")
    write_dng(tmp_path / "a.dng", np.full((32, 48), 900, np.uint16), said)
    return tmp_path / "a.dng"


def test_its_exif_is_what_libraw_says_and_is_read_without_it(frame: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with raw._opened(frame) as opened:
        said = opened.other
        expected = said.shutter_speed, said.iso_speed, said.aperture
    monkeypatch.setattr(raw, "_opened", lambda *_, **__: pytest.fail("the file was decoded"))
    found = exposure_of(frame)
    assert (found.seconds, found.iso, found.aperture) == pytest.approx(expected)
    assert found.seconds == 1 / 250


def test_without_exif_libraw_is_asked(frame: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(raw, "_exif_exposure", lambda _: (0.0, 0.0, 0.0))
    assert exposure_of(frame).seconds == pytest.approx(1 / 250)


@pytest.mark.parametrize(
    ("value", "number"), [((1, 25), 0.04), ((100, 0), 0.0), (100, 100.0), (None, 0.0), ("x", 0.0), ((), 0.0)]
)
def test_numbers_of_exif(value: Any, number: float) -> None:
    assert raw._number(value) == number


def test_an_iso_that_is_said_twice_is_no_fraction(tmp_path: Path) -> None:
    tags: list[Any] = [(33434, "2I", 1, (1, 25), True), (34855, "H", 2, (200, 100), True)]
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), np.uint16), extratags=tags)
    assert raw._exif_exposure(tmp_path / "a.tif") == (0.04, 200.0, 0.0)


def test_an_iso_that_stands_for_a_larger_one_is_none(tmp_path: Path) -> None:
    tags: list[Any] = [(33434, "2I", 1, (1, 25), True), (34855, "H", 1, 65535, True)]
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((4, 4), np.uint16), extratags=tags)
    assert raw._exif_exposure(tmp_path / "a.tif") == (0.04, 0.0, 0.0)
