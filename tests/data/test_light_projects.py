"""Lights of RelightLab's projects and domes, and of LUCES, in files as those write them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from kinran.base.files import InputError
from kinran.data.light import directions
from kinran.data.light_files import find_lights
from kinran.data.light_projects import read_project
from kinran.data.photographs import find

XYZ = [(0.0, 0.6, 0.8), (0.6, 0.0, 0.8), (-0.6, 0.0, 0.8)]


def project(**changes: Any) -> dict[str, Any]:
    """A project of three images, as `Project::save` writes it; `changes` are of its dome."""
    vectors = [dict(zip("xyz", vector, strict=True)) for vector in XYZ]
    images = [{"filename": f"IMG_{k}.JPG", "skip": False, "direction": vectors[k]} for k in range(3)]
    dome = {"imageWidth": 0, "lightConfiguration": "directional", "directions": vectors, "ledAdjust": [], **changes}
    return {"application": "RelightLab", "width": 8, "height": 6, "folder": "images", "images": images, "dome": dome}


def written(folder: Path, value: Any, name: str = "coin.relight") -> Path:
    (folder / name).write_text(json.dumps(value), encoding="utf-8")
    return folder / name


def test_a_project_and_its_images(tmp_path: Path) -> None:
    written(tmp_path, project())
    (tmp_path / "images").mkdir()
    for k in range(3):
        Image.new("RGB", (8, 6)).save(tmp_path / "images" / f"IMG_{k}.JPG")
    lights = find_lights(tmp_path).lights
    np.testing.assert_allclose(directions(lights), XYZ)
    assert find(tmp_path, lights)["IMG_1"] == tmp_path / "images" / "IMG_1.JPG"


@pytest.mark.parametrize("all_vectors", [True, False])
def test_skipped_images_are_left_out(tmp_path: Path, all_vectors: bool) -> None:
    """Whether the dome has a light of them, or none."""
    value = project()
    value["images"][1]["skip"] = True
    if not all_vectors:
        del value["dome"]["directions"][1]
    found = find_lights(tmp_path, written(tmp_path, value))
    assert [light.name for light in found.lights] == ["IMG_0", "IMG_2"]
    np.testing.assert_allclose(directions(found.lights), [XYZ[0], XYZ[2]])
    assert "skips 1 of its images" in found.remarks[0]


def test_positions_and_lamps_that_differ(tmp_path: Path) -> None:
    """A lamp whose photographs are doubled to even it out has half the light."""
    near = [{"x": 300.0 * x, "y": 300.0 * y, "z": 300.0 * z} for x, y, z in XYZ]
    gains = [{"r": 1.0, "g": 1.0, "b": 1.0}, {"r": 2.0, "g": 2.0, "b": 4.0}, {"r": 1.0, "g": 1.0, "b": 1.0}]
    value = project(lightConfiguration="lights3d", positions3d=near, ledAdjust=gains, imageWidth=120)
    found = find_lights(tmp_path, written(tmp_path, value))
    assert [light.length for light in found.lights] == pytest.approx([300] * 3)
    assert [light.intensity for light in found.lights] == [(1, 1, 1), (0.5, 0.5, 0.25), (1, 1, 1)]
    assert "positions in mm; take them with --lamp-mm 1 --field-mm 120" in found.remarks[0]


def test_a_dome_alone_goes_by_order(tmp_path: Path) -> None:
    (tmp_path / "object").mkdir()
    for k in (8, 9, 10):
        Image.new("RGB", (8, 6)).save(tmp_path / "object" / f"P{k}.png")
    lights = find_lights(tmp_path / "object", written(tmp_path, project()["dome"], "ours.dome")).lights
    assert [path.stem for path in find(tmp_path / "object", lights).values()] == ["P8", "P9", "P10"]


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"directions": [{"x": 0, "y": 0, "z": 1}]}, "has 1 lights for 3 images"),
        ({"directions": [{"x": 0, "y": 0, "z": 0}] * 3}, "has no light of IMG_0.JPG; find it in RelightLab"),
        ({"directions": [{"x": 0, "y": 0}] * 3}, "is no project of RelightLab"),
        ({"lightConfiguration": "moon"}, "is no project of RelightLab"),
    ],
)
def test_what_is_wrong_with_a_project(tmp_path: Path, changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        find_lights(tmp_path, written(tmp_path, project(**changes)))


def test_other_json_is_no_project(tmp_path: Path) -> None:
    for text in ("[1, 2]", "{}", "not json"):
        (tmp_path / "x.json").write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match=r"is no project of RelightLab|has no lights"):
            find_lights(tmp_path, tmp_path / "x.json")


@pytest.mark.parametrize("nested", [True, False])
def test_lights_that_a_viewer_reads(nested: bool, tmp_path: Path) -> None:
    """By order; of other pages, such as those of PTM, there are none."""
    vectors = [[0.0, 0.6, 0.8], [0.6, 0.0, 0.8]]
    info = {"type": "rbf", "width": 4, "lights": vectors if nested else [x for v in vectors for x in v]}
    found = read_project(written(tmp_path, info, "info.json"))
    np.testing.assert_allclose([light.direction for light in found.lights], vectors)
    with pytest.raises(InputError, match="has no lights"):
        read_project(written(tmp_path, {"type": "ptm", "width": 4}, "info.json"))
    with pytest.raises(InputError, match="is no project"):
        read_project(written(tmp_path, info | {"lights": [0.0, 0.6]}, "info.json"))


def test_lamps_of_luces(tmp_path: Path) -> None:
    """A camera 200 mm above the middle, x to the right, y down, z ahead: a lamp beside it at the right and the top."""
    header = "N_img nrows ncols f x0 y0 mean_distance sfull:[Lpos Ldir Phi mu 0]\n2 600 800 1000.0 400.0 300.0 200.0"
    rows = ["60 -80 0 0 0 1 2 1 1 0.5 0", "0 0 -10 0 0 1 2 1 1 0.5 0"]
    (tmp_path / "led_params.txt").write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    found = find_lights(tmp_path)
    assert [light.file for light in found.lights] == ["01.png", "02.png"]
    positions = directions(found.lights) * [[light.length] for light in found.lights]
    np.testing.assert_allclose(positions, [[60, 80, 200], [0, 0, 210]], atol=1e-9)
    off_axis = (200 / np.sqrt(60**2 + 80**2 + 200**2)) ** 0.5
    light = [light.intensity for light in found.lights]
    np.testing.assert_allclose(light, [[2 * off_axis, off_axis, off_axis], [2, 1, 1]])
    assert "take them with --lamp-mm 1 --field-mm 160 --camera-mm 200" in found.remarks[0]

    (tmp_path / "led_params.txt").write_text(f"{header}\n{rows[0]}\n", encoding="utf-8")
    with pytest.raises(InputError, match="is not as LUCES has it"):
        find_lights(tmp_path)


def test_directions_without_names_go_by_order(tmp_path: Path) -> None:
    """The mask beside the photographs is none of them."""
    (tmp_path / "light_directions.txt").write_text("0 0.6 0.8\n0.6 0 0.8\n", encoding="utf-8")
    for name in ("a2", "a10", "mask"):
        Image.new("RGB", (8, 6)).save(tmp_path / f"{name}.png")
    lights = find_lights(tmp_path).lights
    assert [path.stem for path in find(tmp_path, lights).values()] == ["a2", "a10"]
