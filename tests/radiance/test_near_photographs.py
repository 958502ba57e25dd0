"""Photographs under lamps at known distances: what their stack holds of geometry, and that its radiance follows it."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from stages import make_stack

from kinran.base.distances import directions_to, falloff, texel_points
from kinran.base.files import InputError
from kinran.capture import ingest, ingest_group
from kinran.capture.photograph_set import Known
from kinran.data.light import LpLight
from kinran.data.light_files import read_lights, write_lp
from kinran.data.radiance_stack import Stack

WIDTH, HEIGHT, FIELD = 60, 40, 120.0
ALBEDO = 0.3
RNG = np.random.default_rng(3)
RADII = RNG.uniform(180, 330, 10)
"""A hand-held lamp, at another distance from the middle of the picture each time (mm)."""


def positions() -> np.ndarray:
    theta, phi = RNG.permutation(np.linspace(0.2, 1.1, 10)), np.arange(10) * 2.4
    return RADII[:, None] * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], 1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A matt plate under a point lamp, as linear 16-bit TIFF, with positions in millimetres in the `.lp`."""
    folder = tmp_path_factory.mktemp("near")
    plate = texel_points(HEIGHT, WIDTH, FIELD / WIDTH)
    lights = []
    for k, position in enumerate(positions()):
        towards = position - plate
        distance = np.linalg.norm(towards, axis=-1)
        light = ALBEDO * 250.0**2 * towards[..., 2] / distance**3
        picture = np.round(65535 * np.clip(light, 0, 1)).astype(np.uint16)[::-1, :, None].repeat(3, 2)
        tifffile.imwrite(folder / f"n{k}.tif", picture)
        length = float(np.linalg.norm(position))
        x, y, z = (float(part) for part in position / length)
        lights.append(LpLight(f"n{k}", (x, y, z), f"n{k}.tif", length=length))
    write_lp(folder / "near.lp", lights)
    return folder


def run(folder: Path, work: Path, crop: str, lamp: float | None, camera: float | None = None) -> Stack:
    plan, manifest = work / "captures/set/plan.json", work / "captures/set/groups/00.json"
    known = {"encoding": "linear", "crop": crop, "lamp_mm": lamp, "field_mm": FIELD if lamp else None}
    options = ingest.Options(**known, camera_mm=camera, fabric="set", holdout=4)
    ingest.main(ingest.Inputs(folder), plan, options)
    ingest_group.main(ingest_group.Inputs(folder, plan), manifest, ingest_group.Options(group="00"))
    return make_stack(work, plan, manifest)


def albedo(stack: Stack) -> np.ndarray:
    """Value over what light, its falloff and its cosine explain, (light, y, x)."""
    values = stack.read_tile(0, stack.height, 0, stack.width).value
    assert stack.texel_mm is not None
    plate = texel_points(stack.height, stack.width, stack.texel_mm)
    lamps = [light.position_mm for light in stack.lights]
    explained = [falloff(lamp, plate) * directions_to(lamp, plate)[..., 2] for lamp in lamps if lamp]
    return np.asarray(values[..., 1] / np.stack(explained))


@pytest.mark.parametrize("crop", ["", "36,2,20,12"])
def test_a_matt_plate_is_even_under_every_lamp(folder: Path, tmp_path: Path, crop: str) -> None:
    """To 0.2 % over the field and over the lights, also where a crop at the corner is the field."""
    stack = run(folder, tmp_path, crop, 1.0, 500.0)
    seen = albedo(stack)
    np.testing.assert_allclose(seen / np.median(seen), 1, atol=2e-3)
    assert stack.texel_mm == pytest.approx(FIELD / WIDTH)
    for light in stack.lights:
        assert light.position_mm is not None
        np.testing.assert_allclose(light.direction, np.array(light.position_mm) / np.linalg.norm(light.position_mm))
    axis = (0.0, 0.0, 500.0) if not crop else (-32.0, -24.0, 500.0)
    np.testing.assert_allclose(stack.camera_mm, axis)


def test_without_distances_the_plate_is_uneven(folder: Path, tmp_path: Path) -> None:
    """The failure: as directions, lights differ by 2.4 times in what they bring, and the field by half."""
    stack = run(folder, tmp_path, "", None)
    assert all(light.position_mm is None for light in stack.lights)
    assert stack.texel_mm is None
    values = stack.read_tile(0, HEIGHT, 0, WIDTH).value
    seen = values[..., 1] / stack.directions[:, 2, None, None]
    middle = seen[:, HEIGHT // 2, WIDTH // 2]
    assert middle.max() / middle.min() > 2.2
    assert (seen.max((1, 2)) / seen.min((1, 2))).max() > 1.5


def test_what_lengths_mean_is_said(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Vectors that may be positions are directions until a length is given; the run says so."""
    run(folder, tmp_path, "", None)
    assert "long and taken for directions; if they are positions, give --lamp-mm" in caplog.text
    caplog.clear()
    run(folder, tmp_path, "", 1.0)
    assert "taken for directions" not in caplog.text
    assert [light.length for light in read_lights(folder / "near.lp").lights] == pytest.approx(RADII)


@pytest.mark.parametrize(
    ("lengths", "says"),
    [
        ((0.0, 60.0, None), "--lamp-mm 0: give a length over 0 mm"),
        ((300.0, None, None), "--lamp-mm: needs the width of a photograph"),
        ((None, None, 300.0), "--camera-mm: needs the width of a photograph"),
        ((None, float("inf"), None), "--field-mm inf"),
    ],
)
def test_lengths_that_cannot_be(lengths: tuple[float | None, ...], says: str) -> None:
    known = Known("srgb", "", *lengths)
    with pytest.raises(InputError, match=says):
        _ = known.distances
