"""The report's pictures under a light that a reader moves: each is the material under its light, the right way up."""

import numpy as np
import pytest

from kinran.base import pictures
from kinran.report.relit import MOST, SIDE, grid, middle, relit_section, tiles
from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import COLOUR, Material
from kinran_bsdf.relight import relight


def cloth(height: int, width: int, theta_max: float = 1.3) -> Material:
    """Grey cloth; its left half faces -weft, its right half +weft, its lowest row of texels +warp."""
    one = np.ones((height, width), np.float32)
    x, y = np.where(np.arange(width) < width / 2, -0.3, 0.3) * one, 0 * one
    x[0], y[0] = 0, 0.3
    maps = {"label": 0 * one, "bound": one, "diffuse.x": 0 * one, "diffuse.y": 0 * one}
    for part, amplitude in (("diffuse", 0.002), ("lobe1", 0.2)):
        maps |= {f"{part}.{c}": one for c in "RGB"} | {f"{part}.amplitude": amplitude * one}
    maps |= {"lobe1.x": x, "lobe1.y": y, "lobe1.xx": 0.01 * one, "lobe1.xy": 0 * one, "lobe1.yy": 0.01 * one}
    regions = [{"label": 0, "name": "cloth", "model": "slope"}]
    return Material(
        channels={name: plane.astype(np.float32) for name, plane in maps.items()},
        model="slope",
        tail="gaussian",
        lobes=1,
        regions=regions,
        colour=COLOUR,
        from_stack=np.eye(3),
        texel_mm=None,
        source="0" * 64,
        theta_max=theta_max,
    )


def tile(sheet: np.ndarray, size: tuple[int, int], column: int, row: int) -> np.ndarray:
    return sheet[row * size[0] : (row + 1) * size[0], column * size[1] : (column + 1) * size[1]]


def test_each_tile_is_the_material_under_its_light() -> None:
    material = cloth(6, 10)
    lights = grid(material.theta_max)
    sheet = tiles(material, lights)
    images = relight(material, lights) @ TO_REC709.T.astype(np.float32)
    exposure = pictures.auto_exposure(images)
    for column, row in ((0, 0), (3, 12), (8, 8), (16, 5)):
        expected = pictures.photograph(images[row * SIDE + column], exposure)
        np.testing.assert_array_equal(tile(sheet, material.size, column, row), expected)


@pytest.mark.parametrize(("column", "row", "bright"), [(12, 8, "right"), (4, 8, "left"), (8, 4, "bottom")])
def test_facets_light_up_when_the_light_comes_from_where_they_look(column: int, row: int, bright: str) -> None:
    material = cloth(6, 10)
    seen = tile(tiles(material, grid(material.theta_max)), material.size, column, row).mean(-1)
    parts = {"left": seen[:-1, :5], "right": seen[:-1, 5:], "bottom": seen[-1:]}
    levels = {name: part.mean() for name, part in parts.items()}
    assert levels.pop(bright) > 2 * max(levels.values())


def test_no_light_is_lower_than_what_was_measured() -> None:
    lights = grid(1.2)
    np.testing.assert_allclose(np.linalg.norm(lights, axis=1), 1, atol=1e-12)
    assert np.arccos(lights[:, 2]).max() == pytest.approx(1.2)
    np.testing.assert_allclose(lights[SIDE**2 // 2], [0, 0, 1], atol=1e-12)


def test_of_a_large_fabric_the_middle_is_shown() -> None:
    material = cloth(MOST + 20, 40)
    part = middle(material)
    assert part.size == (MOST, 40)
    np.testing.assert_array_equal(part.channels["lobe1.x"], material.channels["lobe1.x"][10 : MOST + 10])
    section = relit_section(cloth(8, 8))
    assert section["whole"]
    assert section["sheet"].startswith("data:image/webp;base64,")
