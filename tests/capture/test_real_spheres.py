"""Mirror spheres found in real photographs whose lamps are known."""

from pathlib import Path

import numpy as np
import pytest

from kinran.__main__ import main
from kinran.data.light import directions
from kinran.data.light_files import read_lights

CHROME = """0.484 0.470 0.738, 0.230 0.139 0.963, -0.050 0.177 0.983, -0.108 0.443 0.890, -0.328 0.507 0.797,
 -0.122 0.562 0.818, 0.268 0.425 0.865, 0.088 0.432 0.898, 0.194 0.336 0.922, 0.076 0.334 0.940, 0.117 0.050 0.992,
 -0.153 0.364 0.919"""
"""Directions of `chrome` (xiumingzhang/photometric-stereo), by Accurio in NewProggie/Photometric-Stereo, issue 5."""


def degrees(lp: Path, truth: np.ndarray) -> np.ndarray:
    cosine = (directions(read_lights(lp).lights) * truth).sum(1) / np.linalg.norm(truth, axis=1)
    return np.degrees(np.arccos(np.minimum(cosine, 1)))


@pytest.mark.real
def test_a_chrome_ball_in_the_dark(real_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """To 1.5°, from the outline above alone, which differs by one step of 8 bits; its mask is no light."""
    folder = real_data.parent / "cases" / "rti" / "chrome"
    assert main(["highlights", str(folder), "--out", str(tmp_path / "chrome.lp")]) == 0
    names = [light.name for light in read_lights(tmp_path / "chrome.lp").lights]
    assert "chrome.mask.png: has no compact highlight on the sphere; it is left out" in capsys.readouterr().err
    truth = np.array([[float(word) for word in row.split()] for row in CHROME.split(",")])
    assert sorted(names) == sorted(f"chrome.{k}" for k in range(12))
    assert degrees(tmp_path / "chrome.lp", truth[[int(name.split(".")[1]) for name in names]]).max() < 1.5


@pytest.mark.real
def test_a_glossy_ball(real_data: Path, tmp_path: Path) -> None:
    """DiLiGenT's, in linear light: 96 lights to 1.5°, and the mask is none."""
    folder = real_data / "diligent_ball"
    assert main(["highlights", str(folder), "--out", str(tmp_path / "ball.lp")]) == 0
    lights = read_lights(tmp_path / "ball.lp").lights
    assert [light.name for light in lights] == [f"{k:03d}" for k in range(1, 97)]
    assert degrees(tmp_path / "ball.lp", np.loadtxt(folder / "light_directions.txt")).max() < 1.5


@pytest.mark.real
@pytest.mark.parametrize("name", ["data/realrti/item11", "cases/rti/bunny", "cases/rti/gray_linear", "cases/rti/comma"])
def test_photographs_without_a_sphere(real_data: Path, tmp_path: Path, name: str) -> None:
    """A bronze with glints, a glazed bunny, a matt ball and a small crop."""
    assert main(["highlights", str(real_data.parent / name), "--out", str(tmp_path / "x.lp")]) == 2
    assert not (tmp_path / "x.lp").exists()
