"""The simplest lobes that explain a fabric, chosen by cross-validation over lights."""

import json
from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, pictures
from PIL import Image
from synthetic_texels import grid, radiance, sampled, texels

from kinran.fit import choice, texel_map
from kinran.fit.candidates import CANDIDATES
from kinran_bsdf.material import read_material

SHAPE = (10, 12)
COUNT = SHAPE[0] * SHAPE[1]
LABELS = np.repeat([0, 1], COUNT // 2).reshape(SHAPE)


def chosen(cloth: Cloth) -> dict:
    assert cloth.run("choice", "choice.json", "--picture", cloth.folder / "choice.png") == 0
    return json.loads((cloth.folder / "choice.json").read_text())


def cloth(folder: Path, T: np.ndarray, lights: np.ndarray) -> Cloth:
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal(T.shape)
    return Cloth(folder, pictures(T * noise, SHAPE), directions(lights, every=8), LABELS)


@pytest.fixture(scope="module")
def lights() -> np.ndarray:
    return grid(10, 12)


@pytest.fixture(scope="module")
def half_matte(tmp_path_factory: pytest.TempPathFactory, lights: np.ndarray) -> Cloth:
    """One GGX lobe on region 0; a cosine alone on region 1."""
    shapes, colours = texels(COUNT)
    T = radiance(shapes, colours, lights)
    T[COUNT // 2 :] = colours[COUNT // 2 :, 1, :, None] * lights[:, 2]
    return cloth(tmp_path_factory.mktemp("half"), T, lights)


def test_a_matte_region_gets_no_lobe_and_a_ggx_one_gets_one(half_matte: Cloth) -> None:
    found = chosen(half_matte)
    assert (found["lobes"], found["tail"], found["fitted"]) == (1, "ggx", [0])
    assert found["regions"]["thread0"]["chosen"] == "one GGX lobe"
    assert found["regions"]["thread1"]["chosen"] == "lambert"
    assert found["bytes_per_texel"] == pytest.approx((26 + 10) / 2)
    assert found["bytes_saved"] == pytest.approx(42 - 18)
    assert found["regions"]["thread0"]["one GGX lobe"]["texels"] > 0.9
    assert found["regions"]["thread1"]["lambert"]["texels"] > 0.9
    shown = np.asarray(Image.open(half_matte.folder / "choice.png").convert("L"))
    assert (shown == 150).sum() == pytest.approx((shown == 40).sum(), rel=0.2)


def test_two_lobes_where_two_are_seen(tmp_path: Path, lights: np.ndarray) -> None:
    """A narrow lobe and a wide one that face apart: two pay more than the 0.3 dB of their bytes."""
    shapes, colours = texels(COUNT)
    other, more = texels(COUNT, seed=1)
    other[:, :2] = -shapes[:, :2] + [0.3, 0]
    T = radiance(shapes, colours, lights, "gaussian") + radiance(other, more, lights, "gaussian")
    found = chosen(cloth(tmp_path, T, lights))
    assert (found["lobes"], found["tail"], found["fitted"]) == (2, "gaussian", [0, 1])
    row = found["regions"]["thread0"]
    assert row["two Gaussian lobes"]["psnr"] > row["one GGX lobe"]["psnr"] + 0.3
    assert row["two Gaussian lobes"]["texels"] > 0.7  # where the two face alike, one will do
    assert row["two Gaussian lobes"]["bic"] < row["one GGX lobe"]["bic"]


def test_the_fit_takes_what_was_chosen(half_matte: Cloth) -> None:
    folder = half_matte.folder
    chosen(half_matte)
    given = ["--choice", folder / "choice.json"]
    assert half_matte.run("prior", "prior.json", *given) == 0
    assert half_matte.run("fit", "run.npz", "--model", "slope", *given, "--prior", folder / "prior.json") == 0
    rest = ["--runs", folder / "run.npz", "--summary", folder / "slope.json"]
    assert half_matte.run("material", "slope.exr", "--model", "slope", *given, *rest) == 0
    material = read_material(folder / "slope.exr")
    assert (material.lobes, material.tail) == (1, "ggx")
    assert [region["model"] for region in material.regions] == ["slope", "lambert"]
    assert (material.channels["lobe1.amplitude"][LABELS == 1] == 0).all()
    assert (material.channels["lobe1.amplitude"][LABELS == 0] > 0).all()


def test_held_out_lights_have_no_say(half_matte: Cloth, lights: np.ndarray, tmp_path: Path) -> None:
    shapes, colours = texels(COUNT)
    T = radiance(shapes, colours, lights)
    T[COUNT // 2 :] = colours[COUNT // 2 :, 1, :, None] * lights[:, 2]
    spoilt = T.copy()
    spoilt[:, :, 4::8] = 7.0
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal(T.shape)
    noise[:, :, 4::8] = 1
    again = Cloth(tmp_path, pictures(spoilt * noise, SHAPE), directions(lights, every=8), LABELS)
    assert chosen(again) == chosen(half_matte)


def test_no_choice_file(tmp_path: Path, half_matte: Cloth, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none.json").write_text("{}")
    assert half_matte.run("fit", "run.npz", "--model", "slope", "--choice", tmp_path / "none.json") == 2
    assert "kinran choice" in capsys.readouterr().err


def test_bytes_cost_decibels() -> None:
    """A candidate that gains 0.2 dB with a lobe more is not taken; one that gains 0.4 dB is."""
    share = np.ones(1)
    for gain, name in ((0.2, "one GGX lobe"), (0.4, "two Gaussian lobes")):
        judged = {}
        for candidate, db in zip(CANDIDATES, (10, 30, 30 + gain), strict=True):
            zero = np.zeros(1)
            judged[candidate.name] = choice.Judgement(np.full((5, 1), 10 ** (-db / 10)), zero, zero, zero)
        best, kinds = choice.choose(judged, share)
        assert (best.name, kinds[0].name) == (name, name)


def test_a_texels_byte_costs_its_part_of_the_fabrics_decibels() -> None:
    """What 0.3 dB of the fabric's error are, a texel's second lobe has to take away from the texel's."""
    worth = 0.3 / 10 * np.log(10)
    errors = [np.full(2, 9.0), np.full(2, 1.0), 1 - worth * np.array([0.9, 1.1])]
    np.testing.assert_array_equal(texel_map.simplest(errors, 1.0), [1, 2])


def test_error_under_lights_left_out(lights: np.ndarray) -> None:
    """A cosine that is fitted to noise: what is left under its own lights says what it leaves under others."""
    rng = np.random.default_rng(0)
    few = lights[::8]
    clean = np.ones((4000, 3, 1)) * few[:, 2]
    seen, other = ((clean + 0.1 * rng.standard_normal(clean.shape)).astype(np.float32) for _ in range(2))
    scale = (seen * few[:, 2]).sum(2) / (few[:, 2] ** 2).sum()
    fitted = (scale[:, :, None] * few[:, 2]).astype(np.float32)
    plain = np.mean((fitted - seen) ** 2)
    truth = np.mean((fitted - other) ** 2)

    def left_out(numbers: int) -> np.ndarray:
        return texel_map.left_out(sampled(seen, few), fitted, lambda light: light, numbers)

    assert np.mean(left_out(3)) == pytest.approx(truth, rel=0.02)
    assert plain < 0.9 * truth
    assert np.isinf(left_out(3 * len(few))).all()
