"""The maps of `kinran sigma`: as large as the errors of the fit, and honest about what the lights cannot tell."""

import json
from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, no_prior, pictures
from synthetic_texels import grid, radiance, texels

from kinran.base.exr import read_exr
from kinran.fit.sigma import parameters
from kinran.fit.solver.lobes import squared_widths
from kinran_bsdf.material import Material

SHAPE = (16, 24)


def sigma(cloth: Cloth) -> dict[str, np.ndarray]:
    folder = cloth.folder
    no_prior(folder / "flat.json")
    given = ["--prior", folder / "flat.json", "--material", folder / "slope.exr"]
    given += ["--summary", folder / "sigma.json", "--picture", folder / "sigma.png"]
    assert cloth.run("sigma", "sigma.exr", *given) == 0
    return read_exr(folder / "sigma.exr")


def noisy(T: np.ndarray, sd: float) -> np.ndarray:
    return T + sd * np.random.default_rng(1).standard_normal(T.shape)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> tuple[Material, dict[str, np.ndarray], tuple]:
    shapes, colours = texels(SHAPE[0] * SHAPE[1])
    lights = grid(10, 24)
    samples = noisy(radiance(shapes, colours, lights), 0.02)
    cloth = Cloth(tmp_path_factory.mktemp("cloth"), pictures(samples, SHAPE), directions(lights))
    return cloth.fit(), sigma(cloth), (shapes, colours, cloth)


def test_errors_are_as_large_as_their_deviations(fitted: tuple) -> None:
    """Over 384 texels z = (fitted - true) / sigma has a spread of 0.85 to 1.15; |z| < 2 in 92 to 98 %."""
    material, maps, (shapes, colours, _) = fitted
    xx, xy, yy = squared_widths(shapes[:, :5])
    true = {"lobe1.x": shapes[:, 0], "lobe1.y": shapes[:, 1], "lobe1.xx": xx, "lobe1.xy": xy, "lobe1.yy": yy}
    true |= {"diffuse.x": shapes[:, 5], "diffuse.y": shapes[:, 6]}
    true |= {f"lobe1.{c}": colours[:, 0, i] / np.pi for i, c in enumerate("RGB")}
    for name, value in true.items():
        plane = material.channels[name]
        if name[-1] in "RGB":
            plane = plane * material.channels["lobe1.amplitude"]
        z = (plane.ravel() - value) / maps[f"sigma.{name}"].ravel()
        robust = 1.4826 * np.median(np.abs(z))
        assert 0.85 < robust < 1.15, name
        assert 0.92 < np.mean(np.abs(z) < 2) < 0.98, name


def test_medians_of_regions(fitted: tuple) -> None:
    _, maps, (_, _, cloth) = fitted
    lobe = json.loads((cloth.folder / "sigma.json").read_text())["thread0"]["lobe1"]
    expected = np.degrees(np.arctan(np.median(np.hypot(maps["sigma.lobe1.x"], maps["sigma.lobe1.y"]))))
    assert lobe["normal_degrees"] == pytest.approx(expected, rel=1e-3)
    assert lobe["share_of_texels"] == 1
    assert lobe["unresolved"] < 0.02


def test_parameters_are_those_that_the_material_was_made_of(fitted: tuple) -> None:
    material, _, (_, colours, _) = fitted
    made_of = parameters(material)
    found = np.stack(squared_widths(made_of.lobe(0)), 1)
    planes = np.stack([material.channels[f"lobe1.{name}"].ravel() for name in ("xx", "xy", "yy")], 1)
    np.testing.assert_allclose(found, planes, rtol=1e-4, atol=1e-7)
    np.testing.assert_allclose(np.median(np.abs(made_of.colours - colours), 0), 0, atol=0.02)


def test_lobes_between_the_lights_are_not_resolved(tmp_path: Path) -> None:
    """Widths (1/e) of 0.01 and 0.1 under a grid whose lights are 0.044 apart in slope: all and none are flagged."""
    lights = grid(5, 24)
    shapes, colours = texels(SHAPE[0] * SHAPE[1])
    shapes[:, 3] = 0
    shapes[:, [2, 4]] = -np.log(0.1)
    shapes[:192, [2, 4]] = -np.log(0.01)
    samples = noisy(radiance(shapes, colours, lights), 0.003)
    cloth = Cloth(tmp_path, pictures(samples, SHAPE), directions(lights))
    cloth.fit()
    flags = sigma(cloth)["lobe1.unresolved"].ravel() > 0
    assert flags[:192].mean() > 0.9
    assert flags[192:].mean() < 0.02


def test_a_texture_has_no_lobe_to_be_unsure_of(tmp_path: Path) -> None:
    lights = grid(20, 8)
    shapes, colours = texels(64)
    labels = np.repeat([0, 1], 32).reshape(8, 8)
    cloth = Cloth(tmp_path, pictures(radiance(shapes, colours, lights), (8, 8)), directions(lights), labels)
    material = cloth.fit("--fitted", 0)
    no_prior(tmp_path / "two.json", regions=2)
    assert (material.channels["lobe1.amplitude"][labels == 1] == 0).all()
    given = ["--prior", tmp_path / "two.json", "--material", tmp_path / "slope.exr"]
    given += ["--summary", tmp_path / "s.json", "--picture", tmp_path / "s.png"]
    assert cloth.run("sigma", "sigma.exr", *given) == 0
    maps = read_exr(tmp_path / "sigma.exr")
    assert np.isinf(maps["sigma.lobe1.x"][labels == 1]).all()
    assert (maps["lobe1.unresolved"][labels == 1] == 0).all()
    assert list(json.loads((tmp_path / "s.json").read_text())["thread1"]) == []
