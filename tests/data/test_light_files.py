"""`.lp` files, good and bad."""

from pathlib import Path

import numpy as np
import pytest

from kinran.base import frames
from kinran.base.files import InputError
from kinran.capture.grid import plan_grid
from kinran.data.light import SCATTERED, Light, LpLight, directions, half_steps
from kinran.data.light_files import find_lights, read_lights, write_lp

GOOD = "2\nsome folder\\image 01.jpg 0 0 2\nimage02.jpg 0.6 0 0.8\n"


def write(folder: Path, text: str) -> Path:
    path = folder / "dirs.lp"
    path.write_text(text, encoding="utf-8")
    return path


def test_reads_names_with_folders_and_spaces_and_normalises(tmp_path: Path) -> None:
    lights = read_lights(write(tmp_path, GOOD)).lights
    assert [light.name for light in lights] == ["image 01", "image02"]
    assert lights[0].file == "image 01.jpg"
    np.testing.assert_allclose(directions(lights), [[0, 0, 1], [0.6, 0, 0.8]])


def test_byte_order_mark_and_blank_lines(tmp_path: Path) -> None:
    assert len(read_lights(write(tmp_path, "\ufeff" + GOOD.replace("\n", "\n\n"))).lights) == 2


@pytest.mark.parametrize(
    "data",
    [
        ("# made by hand\n" + GOOD).encode(),
        GOOD.replace("\n", "\n# a note of three words 1 2 x\n", 1).encode(),
        GOOD.replace("\n", "\r\n").encode(),
        GOOD.replace("\n", "\r").encode(),
        GOOD.replace("\n", " \n").replace("image02.jpg ", "image02.jpg\t").encode(),
        GOOD.encode("utf-16"),
        GOOD.replace("some folder\\image 01.jpg", '"image 01.jpg"').encode(),
    ],
    ids=["comment", "comment inside", "CRLF", "CR", "tabs", "UTF-16", "quotes"],
)
def test_what_other_programs_write(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "dirs.lp").write_bytes(data)
    lights = read_lights(tmp_path / "dirs.lp").lights
    assert [light.file for light in lights] == ["image 01.jpg", "image02.jpg"]
    np.testing.assert_allclose(directions(lights), [[0, 0, 1], [0.6, 0, 0.8]])
    assert [light.length for light in lights] == pytest.approx([2, 1])


def test_names_of_another_code_page(tmp_path: Path) -> None:
    (tmp_path / "dirs.lp").write_bytes("1\nétoffe.jpg 0 0 1\n".encode("cp1252"))
    assert read_lights(tmp_path / "dirs.lp").lights[0].name == "étoffe"


def test_a_name_that_begins_with_the_sign_of_a_comment(tmp_path: Path) -> None:
    assert [light.name for light in read_lights(write(tmp_path, "1\n#1.jpg 0 0 1\n")).lights] == ["#1"]


@pytest.mark.parametrize(
    ("file", "folder"),
    [
        ("photos/a.jpg", "photos"),
        ("photos\\left one\\a.jpg", "photos/left one"),
        ("C:\\set 1\\a.jpg", ""),
        ("/home/me/a.jpg", ""),
        ("../other/a.jpg", "../other"),
        ("a.jpg", ""),
    ],
)
def test_folders_beside_the_file_count(tmp_path: Path, file: str, folder: str) -> None:
    light = read_lights(write(tmp_path, f"1\n{file} 0 0 1\n")).lights[0]
    assert (light.name, light.file, light.folder) == ("a", "a.jpg", folder)


def test_writes_what_it_reads(tmp_path: Path) -> None:
    lights = [LpLight("a", (0.0, 0.0, 1.0), "a.png"), LpLight("b c", (0.6, 0.0, 0.8), "b c.png")]
    write_lp(tmp_path / "x.lp", lights)
    assert read_lights(tmp_path / "x.lp").lights == lights


def test_more_than_a_thousand_lights(tmp_path: Path) -> None:
    rows = "\n".join(f"image{k}.jpg 0 {k / 2000} 1" for k in range(1224))
    assert len(read_lights(write(tmp_path, f"1224\n{rows}\n")).lights) == 1224


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("3\na.jpg 0 0 1\nb.jpg 0 0 1\n", "says 3 lights but 2 follow"),
        ("1\na.jpg 0 0 0\n", "light vector 0.0 0.0 0.0"),
        ("1\na.jpg 0 nan 1\n", "light vector 0.0 nan 1.0"),
        ("1\na.jpg 0 inf 1\n", "light vector"),
        ("1\na.jpg 1 0 0\n", "no light over the horizon"),
        ("2\na.jpg 0 0 1\na.png 0 0.1 1\n", "names 'a' again (first in line 2)"),
        ("1\na.jpg 0 1\n", "is not 'file x y z'"),
        ("1\na.jpg 0 x 1\n", "is not 'file x y z'"),
        ("1\na.jpg 0 0 1 0.7\n", "line 2 has more than three numbers: 'a.jpg 0 0 1 0.7'"),
        ("1\na b.jpg 0.1 0.2 0.9 255 255 255\n", "line 2 has more than three numbers"),
        ("1\na.jpg,0,0,1\n", "is not 'file x y z'"),
        ("a.jpg 0 0\n", "first line is not the number of lights"),
        ("", "first line is not the number of lights"),
    ],
)
def test_bad_files_are_refused_in_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = write(tmp_path, text)
    with pytest.raises(InputError) as error:
        read_lights(path)
    assert says in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "count", "remark"),
    [
        ("2\na.jpg 0,6 0 0,8\nb.jpg 0 -0,6 0,8\n", 2, ""),
        ("a.jpg 0.6 0 0.8\nb.jpg 0 -0.6 0.8\n", 2, "does not begin with the number of lights; all 2 lines are taken"),
        (
            "3\na.jpg 0.6 0 0.8\nb.jpg 0 -0.6 0.8\nc.jpg 1 0 -0.001\n",
            2,
            "1 light is at or under the horizon and left out",
        ),
        ("2\na.jpg 0.6 0 -0.8\nb.jpg 0 -0.6 -0.8\n", 2, "z is taken to point away from the camera"),
    ],
    ids=["decimal commas", "no number", "one at the horizon", "z away from the camera"],
)
def test_what_a_file_does_not_state_is_said(tmp_path: Path, text: str, count: int, remark: str) -> None:
    found = read_lights(write(tmp_path, text))
    np.testing.assert_allclose(directions(found.lights), [[0.6, 0, 0.8], [0, -0.6, 0.8]][:count])
    assert len(found.remarks) == bool(remark)
    assert remark in "".join(found.remarks)


def test_a_photometric_set(tmp_path: Path) -> None:
    """Directions, names and intensities in files of their own, as DiLiGenT has them."""
    (tmp_path / "light_directions.txt").write_text("0.6 0 0.8\n0 -0.6 0.8\n")
    (tmp_path / "filenames.txt").write_text("001.png\n002.png\n")
    assert [light.intensity for light in find_lights(tmp_path).lights] == [None, None]
    (tmp_path / "light_intensities.txt").write_text("1 2 3\n2 4 6\n")
    lights = find_lights(tmp_path).lights
    assert [light.file for light in lights] == ["001.png", "002.png"]
    assert [light.intensity for light in lights] == [(1, 2, 3), (2, 4, 6)]
    np.testing.assert_allclose(directions(lights), [[0.6, 0, 0.8], [0, -0.6, 0.8]])
    (tmp_path / "filenames.txt").write_text("001.png\n")
    with pytest.raises(InputError, match=r"has 2 lights but filenames\.txt 1 images"):
        find_lights(tmp_path)


def test_where_a_file_of_lights_is_looked_for(tmp_path: Path) -> None:
    """Beside the photographs, but for what macOS keeps there, else in a project's folder, or where it is said to be."""
    (tmp_path / "assembly-files").mkdir()
    (tmp_path / "assembly-files" / "3.lp").write_text(GOOD)
    (tmp_path / "._3.lp").write_bytes(b"\0\5\x16\7")
    assert find_lights(tmp_path).path == tmp_path / "assembly-files" / "3.lp"
    beside = write(tmp_path, GOOD)
    assert find_lights(tmp_path).path == beside
    assert find_lights(tmp_path, tmp_path / "assembly-files" / "3.lp").path.name == "3.lp"


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read"):
        read_lights(tmp_path / "none.lp")


def grid(phis: int) -> list[Light]:
    """Lights at θ = 0 and on three rows."""
    planned = plan_grid("cloth", [0, 20, 40, 60], phis, [1.0], meridians=phis).lights
    return [Light(light.name, light.direction, grid=light.grid) for light in planned]


@pytest.mark.parametrize(("phis", "across"), [(8, [4]), (9, [4, 5])])
def test_half_steps_tell_rows_and_meridians_of_a_grid_apart(phis: int, across: list[int]) -> None:
    """A row is found by its θ alone, and the meridian across: two where their number is odd."""
    lights = grid(phis)
    theta, phi = frames.angles(directions(lights))
    half_theta, half_phi = half_steps(lights)
    assert half_theta == pytest.approx(np.radians(10))
    rows = {light.grid[0] for light, t in zip(lights, theta, strict=True) if abs(t - np.radians(40)) < half_theta}
    assert rows == {2}
    off = np.abs(frames.wrap(phi - np.pi))
    found = {light.grid[1] for light, d in zip(lights, off, strict=True) if light.grid[0] and d < half_phi}
    assert sorted(found) == across


def test_half_steps_without_a_grid() -> None:
    scattered = [*grid(8), Light("elsewhere", (0.0, 0.6, 0.8))]
    np.testing.assert_allclose(np.degrees(half_steps(scattered)), SCATTERED)
