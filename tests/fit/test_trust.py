"""What the fits take of a set whose lights or samples are not all as they should be."""

import logging
from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, pictures
from synthetic_texels import grid, sampled, texels

from benchmarks.texels import microfacets, noisy
from kinran.base import frames
from kinran.base.files import read_json
from kinran.data.fabric import Fabric
from kinran.data.radiance_stack import Light
from kinran.fit import trust
from kinran.fit.region_priors import Prior, Priors
from kinran.fit.slope_lobes import Lobes
from kinran_bsdf.relight import relight

LIGHTS = grid(10, 12)
SHAPE = (8, 10)
TRUTH = microfacets(*texels(SHAPE[0] * SHAPE[1]), LIGHTS)
ODD = np.array([9, 31, 55, 80])


def turned() -> np.ndarray:
    """The lights as a list says that has four of them 20° off."""
    theta, phi = frames.angles(LIGHTS)
    theta[ODD] += np.radians(20) * np.where(theta[ODD] > 0.7, -1, 1)
    return frames.direction(theta, phi)


def with_outliers(share: float) -> np.ndarray:
    rng = np.random.default_rng(3)
    hit = rng.random((len(TRUTH), 1, len(LIGHTS))) < share
    level = rng.uniform(0, 1.5, hit.shape) * TRUTH.max((1, 2), keepdims=True)
    return np.where(hit, level, noisy(TRUTH)).astype(np.float32)


def learn(T: np.ndarray, listed: np.ndarray = LIGHTS) -> tuple[np.ndarray, bool]:
    return trust.learn(sampled(T, listed), Lobes(), 1)


def test_what_fits_in_is_trusted() -> None:
    factors, outliers = learn(noisy(TRUTH))
    np.testing.assert_array_equal(factors, 1)
    assert not outliers


def test_lights_that_stand_elsewhere() -> None:
    factors, outliers = learn(noisy(TRUTH), turned())
    assert factors[ODD].max() < 0.5
    assert (np.delete(factors, ODD) < 1).sum() <= 2
    assert not outliers


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_outliers(share: float) -> None:
    factors, outliers = learn(with_outliers(share))
    assert outliers
    np.testing.assert_array_equal(factors, 1)


def test_too_few_lights_or_no_texels() -> None:
    T = noisy(TRUTH)
    assert (learn(T[..., :6], LIGHTS[:6])[0] == 1).all()
    assert not learn(T[:0])[1]


def error(folder: Path, T: np.ndarray, listed: np.ndarray, prior: bool) -> float:
    """Of the material that the stages make, under the true lights."""
    folder.mkdir()
    material = Cloth(folder, pictures(T, SHAPE), directions(listed)).fit(prior=prior)
    truth = pictures(TRUTH, SHAPE)
    return float(np.sqrt(np.square(relight(material, LIGHTS) - truth).sum() / np.square(truth).sum()))


def test_the_stages_take_what_they_trust(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Four lights of 97 off by 20°: .073 alone, .027 by what is trusted; 5 % outliers: .73 and .19."""
    caplog.set_level(logging.INFO, "kinran")
    for name, T, listed in (("lights", noisy(TRUTH), turned()), ("samples", with_outliers(0.05), LIGHTS)):
        alone, known = (error(tmp_path / f"{name}{prior}", T, listed, prior) for prior in (False, True))
        assert known < 0.5 * alone, name
        assert known < 0.25, name
    said = caplog.text
    assert all(f"light l{k}: does not fit in" in said for k in ODD)
    assert "outliers" in said
    assert read_json(tmp_path / "samplesTrue" / "prior.json")["trust"] == {"lights": {}, "outliers": True}


def test_lights_are_known_by_their_names(tmp_path: Path) -> None:
    lights = [Light(name, (0.0, 0.0, 1.0)) for name in "abc"]
    path = tmp_path / "prior.json"
    Priors([Prior(np.zeros(7), 0.1)], np.array([1, 0.25, 1], np.float32), outliers=True).write(path, lights)
    assert read_json(path)["trust"] == {"lights": {"b": 0.25}, "outliers": True}
    Cloth(tmp_path, np.zeros((3, 1, 1, 3)), [*lights[1:], Light("held", (0.0, 0.0, 1.0), held_out=True)])
    np.testing.assert_array_equal(Priors.read(path, Fabric(tmp_path)).lights, [0.25, 1])
