"""A field of 60 mm, lamp and camera at 600 mm: normals bend towards the edges unless each texel has its own lights."""

from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions
from flat_field import DISTANCE, FIELD, SIDE, flat_cloths, flat_field
from synthetic_texels import grid

from kinran.base.files import read_json
from kinran.data import material_prediction, texel_directions
from kinran.data.radiance_stack import Stack
from kinran_bsdf.material import Material, read_material


@pytest.fixture(scope="module")
def cloths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cloth]:
    return flat_cloths(tmp_path_factory.mktemp("cloths"))


def bends(material: Material) -> np.ndarray:
    """Angle between the lobe's normal and N, in degrees."""
    return np.degrees(np.arctan(np.hypot(material.channels["lobe1.x"], material.channels["lobe1.y"])))


def held_out_error(cloth: Cloth) -> float:
    given = ["--materials", cloth.folder / "slope.exr", "--picture", cloth.folder / "errors.png", "--name", "cloth"]
    assert cloth.run("evaluate", "errors.json", *given) == 0
    return float(read_json(cloth.folder / "errors.json")["methods"]["slope"]["relative_error"])


def test_normals_brightness_and_error_over_the_field(cloths: dict[str, Cloth]) -> None:
    """Edges bend by 2.9° and corners by 4° as if the lamp were far, and by under 0.15° with what is known."""
    far, known = cloths["far"].fit(), cloths["near"].fit()
    edge = bends(far)[SIDE // 2, 0]
    assert edge == pytest.approx(np.degrees(np.arctan(0.5 * 2 * (FIELD / 2 - FIELD / SIDE / 2) / DISTANCE)), rel=0.1)
    assert bends(far).max() > 3.3
    assert bends(known).max() < 0.15
    amplitude = known.channels["lobe1.amplitude"]
    assert np.ptp(amplitude) < 0.02 * amplitude.mean()
    assert held_out_error(cloths["far"]) > 5 * held_out_error(cloths["near"])


def test_texels_have_lights_of_their_own_in_what_a_material_predicts(cloths: dict[str, Cloth]) -> None:
    cloth = cloths["near"]
    material = cloth.fit()
    stack = Stack.open(cloth.stack)
    predicted = material_prediction.predict(material, stack, (0, SIDE, 0, SIDE), np.array([30]))[0]
    np.testing.assert_allclose(predicted, flat_field(np.array(stack.lights[30].direction)), rtol=0.02, atol=0.01)


def test_cells_are_small_against_a_lobe(tmp_path: Path) -> None:
    """20 mm at 1.6 m: edges bend by 0.36°, and texels of a cell of 3.2 mm by under 0.06° from its middle."""
    field, distance = 20.0, 1600.0
    lights = grid(10, 12)
    radiance = np.stack([flat_field(light, field, distance) for light in lights])
    known = directions(lights, distance, 8)
    cloth = Cloth(tmp_path, radiance, known, texel_mm=field / SIDE, camera_mm=(0, 0, distance))
    assert len(texel_directions.under(Stack.open(cloth.stack), (0, SIDE, 0, SIDE), np.arange(8)).lights) < SIDE**2
    assert bends(cloth.fit()).max() < 0.06
    assert held_out_error(cloth) < 0.01


def test_a_small_field_does_not_matter(tmp_path: Path) -> None:
    """Half vectors turn by 0.001 to the edge of 1.2 mm at 600 mm."""
    lights = grid(40, 4)
    radiance = np.ones((len(lights), 8, 8, 3))
    known = directions(lights, DISTANCE)
    for texel_mm, expected in ((1.1 / 8, False), (1.3 / 8, True)):
        cloth = Cloth(tmp_path / str(texel_mm), radiance, known, texel_mm=texel_mm, camera_mm=(0, 0, DISTANCE))
        assert texel_directions.matters(Stack.open(cloth.stack)) is expected


def test_nothing_is_known_of_lights_without_positions(cloths: dict[str, Cloth]) -> None:
    assert not texel_directions.matters(Stack.open(cloths["far"].stack))


def test_a_residual_lies_on_lobes_with_their_own_lights(cloths: dict[str, Cloth]) -> None:
    """`kinran residual` takes what the near lobes leave, which is nothing: none is chosen."""
    cloth = cloths["near"]
    cloth.fit(prior=True)
    folder = cloth.folder
    given = ["--prior", folder / "prior.json", "--material", folder / "slope.exr", "--fitted", folder / "slope.json"]
    assert cloth.run("residual", "with.exr", *given, "--summary", folder / "with.json") == 0
    material = read_material(folder / "with.exr")
    stack = Stack.open(cloth.stack)
    predicted = material_prediction.predict(material, stack, (0, SIDE, 0, SIDE), np.array([30]))[0]
    np.testing.assert_allclose(predicted, flat_field(np.array(stack.lights[30].direction)), rtol=0.03, atol=0.02)
