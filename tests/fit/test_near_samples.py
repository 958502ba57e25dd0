"""A lamp at 600 mm over a field of 60 mm reaches all that is learned from samples, not the fit alone.

One flat material in three regions, left, middle and right: read with positions it is flat, and as if the lamps were
far it is bent, and shaded by their falloff.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from flat_field import SIDE, flat_cloths

from kinran.data.fabric import Fabric
from kinran.fit import choice, gauss_newton, learned_priors, residual, shrinkage, slope, trust
from kinran.fit.candidates import display
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples, read_some, spread_over_regions
from kinran.fit.slope_lobes import Lobes

LABELS = np.repeat(np.arange(SIDE)[None] // 3, SIDE, 0)
WAYS = ("far", "near")


@dataclass(frozen=True)
class Learned:
    """Samples of a cloth, and the priors of its regions."""

    fabric: Fabric
    samples: Samples
    priors: list[Prior]


@pytest.fixture(scope="module")
def of(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Learned]:
    result = {}
    for name, cloth in flat_cloths(tmp_path_factory.mktemp("cloths"), LABELS).items():
        fabric = Fabric(cloth.folder)
        samples = read_some(fabric, spread_over_regions(fabric.labels, 3, 512))
        result[name] = Learned(fabric, samples, learned_priors.learn_priors(samples, 3, Lobes()))
    return result


def test_priors(of: dict[str, Learned]) -> None:
    """Regions at the edge face 1.9° away from each other, or as the material does, to 0.01°."""
    tilt = {name: [float(np.degrees(np.arctan(p.centre[0]))) for p in of[name].priors] for name in WAYS}
    np.testing.assert_allclose(tilt["far"], [-1.95, 0, 1.95], atol=0.02)
    np.testing.assert_allclose(tilt["near"], 0, atol=0.01)
    variance = {name: np.mean([p.variance for p in of[name].priors]) for name in WAYS}
    assert variance["near"] < 0.01 * variance["far"]


def test_trust(of: dict[str, Learned]) -> None:
    """As if they were far, a fifth of the lamps do not fit in with their neighbours; as they are, all do."""
    odd = {name: (trust.learn(of[name].samples, Lobes(), 1)[0] < 1).sum() for name in WAYS}
    assert odd["far"] > 15
    assert odd["near"] == 0


def test_strength(of: dict[str, Learned]) -> None:
    """What lights left out say of a prior: 400 times less is left of them."""
    left = {name: shrinkage._errors(of[name].priors, of[name].samples, Lobes(), 1).sum() for name in WAYS}
    assert left["near"] < left["far"] / 400


def test_choice(of: dict[str, Learned]) -> None:
    """One lobe explains lights left out to 0.03 %, and to 0.6 % as if lamps were far."""
    relative = {}
    for name in WAYS:
        shown = display(of[name].fabric.stack, of[name].samples.T)
        relative[name] = choice.judge(of[name].samples, shown, 1)["one GGX lobe"].relative
    assert relative["far"].min() > 0.005
    assert relative["near"].max() < 0.0005


def test_residual(of: dict[str, Learned]) -> None:
    """The lobes alone are 25 dB nearer to lights left out, and exact."""
    alone = {name: residual.cross_validate(of[name].samples, Lobes(), of[name].priors, "log:2") for name in WAYS}
    assert alone["near"].lobes_psnr > max(alone["far"].lobes_psnr + 25, residual.EXACT_DB - 0.1)


def test_uncertainty(of: dict[str, Learned]) -> None:
    """A model that says it all is ten times as sure of its normals."""
    sd = {}
    for name in WAYS:
        covariance = gauss_newton.covariances(slope.fit(of[name].samples, Lobes()), of[name].samples)
        sd[name] = np.median(np.sqrt(covariance[:, 0, 0]))
    assert sd["near"] < 0.1 * sd["far"]
