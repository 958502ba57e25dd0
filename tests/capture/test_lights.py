"""The command that shows, drops and edits the lights of photographs."""

from pathlib import Path

import numpy as np
import pytest

from kinran.__main__ import main
from kinran.data.light import directions
from kinran.data.light_files import read_lights

LP = "4\nup.jpg 0 0.6 0.8\nright.jpg 0.6 0 0.8\nplates/top.jpg 0 0 2\nUnder.jpg 0 0.6 -0.8\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "dome.lp").write_text(LP, encoding="utf-8")
    return tmp_path


def test_shows_a_table_and_a_picture(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["lights", str(folder), "--draw", str(folder / "dome.svg")]) == 0
    shown = capsys.readouterr()
    assert [line.split() for line in shown.out.splitlines()] == [
        ["image", "x", "y", "z", "elevation", "azimuth", "next", "light"],
        ["up.jpg", "0.0000", "0.6000", "0.8000", "53.1°", "90.0°", "36.9°"],
        ["right.jpg", "0.6000", "0.0000", "0.8000", "53.1°", "0.0°", "36.9°"],
        ["top.jpg", "0.0000", "0.0000", "2.0000", "90.0°", "0.0°", "36.9°"],
    ]
    assert "1 light is at or under the horizon and left out (Under.jpg)" in shown.err
    picture = (folder / "dome.svg").read_text()
    assert "right.jpg: elevation 53.1°, azimuth 0.0°" in picture
    assert sorted(path.name for path in folder.iterdir()) == ["dome.lp", "dome.svg"]


def test_writes_what_is_left_with_the_edits(folder: Path) -> None:
    """Signs are turned before lights under the horizon are left out."""
    out = folder / "new" / "dome.lp"
    out.parent.mkdir()
    edits = ["--drop", "UP", "--mirror", "x", "z", "--scale", "10"]
    assert main(["lights", str(folder), *edits, "--out", str(out), "--drop", "top.jpg"]) == 2
    assert not out.exists()  # of the others, all have z < 0
    edits = ["--drop", "UP", "top.jpg", "--mirror", "x", "--scale", "10"]
    assert main(["lights", str(folder), *edits, "--out", str(out)]) == 0
    (light,) = read_lights(out).lights
    assert (light.file, light.length) == ("right.jpg", pytest.approx(10))
    np.testing.assert_allclose(directions([light]), [[-0.6, 0, 0.8]])

    assert main(["lights", str(folder), "--mirror", "z", "--out", str(out)]) == 0
    assert [light.file for light in read_lights(out).lights] == ["Under.jpg"]


def test_keeps_folders_of_images(folder: Path) -> None:
    out = folder / "new.lp"
    assert main(["lights", str(folder), "--lp", str(folder / "dome.lp"), "--out", str(out)]) == 0
    assert [light.folder for light in read_lights(out).lights] == ["", "", "plates"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--drop", "left"], "--drop left: no light has that image; the first is up.jpg"),
        (["--drop", "up", "right", "top"], "--drop: leaves no light"),
        (["--scale", "0"], "--scale 0: give a factor over 0"),
        (["--draw", "dome.jpg"], "dome.jpg: is neither .svg nor .png"),
    ],
)
def test_what_must_stop(folder: Path, capsys: pytest.CaptureFixture[str], options: list[str], says: str) -> None:
    assert main(["lights", str(folder), *options, "--out", str(folder / "x.lp")]) == 2
    assert says in capsys.readouterr().err
    assert not (folder / "x.lp").exists()
