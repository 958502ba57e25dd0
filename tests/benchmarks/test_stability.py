"""Where fits fail: a case of `kinran bench stability` shows the failure with a number, then that the remedy holds."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from synthetic_texels import grid, sampled

from benchmarks import stability
from benchmarks.stability import (
    BOUNDED,
    DRIFT,
    FACE,
    FOUR,
    GGX,
    HELD,
    JOINT,
    MONITORS,
    NEEDLES,
    PAIR,
    PRINTED,
    RESOLVED,
    TRUSTED,
    WEIGHED,
)
from benchmarks.texels import Split, facets, noisy, radiance, relative, texels
from kinran.__main__ import main
from kinran.base import frames
from kinran.base.files import read_json
from kinran.data.texel_directions import Under
from kinran.fit import learned_priors, robust_weights, slope
from kinran.fit.slope_lobes import Lobes

Table = dict[tuple[str, str], float]


@pytest.fixture(scope="session")
def lights() -> np.ndarray:
    return grid()


@pytest.fixture(scope="module")
def split() -> Split:
    return Split.of_grid()


@pytest.fixture(scope="module")
def table(split: Split) -> Callable[[Callable], Table]:
    """Errors of a case by (parameter, method); what is not finite is infinite."""

    def measure(case: Callable) -> Table:
        rows = list(case(split))
        return {(r["parameter"], r["method"]): np.inf if r["error"] is None else r["error"] for r in rows}

    return measure


def test_pole(table: Callable) -> None:
    """Eq. 3, even fitted jointly, is at its worst around the pole; slopes know no pole."""
    errors = table(stability.pole)
    assert errors["tilt 0°", FOUR] > 0.4
    assert errors["tilt 5°", JOINT] > 0.15
    assert errors["tilt 5°", JOINT] > 2 * errors["tilt 0°", JOINT]
    assert max(error for (_, method), error in errors.items() if method == GGX) < 0.06


def test_azimuth_wraps(table: Callable) -> None:
    """A lobe at φ = 355° loses half of itself to the formula as printed, and nothing to the wrapped one."""
    errors = table(stability.azimuth_wrap)
    assert errors["φ_n 180°", PRINTED] < 0.01
    assert errors["φ_n 355°", PRINTED] > 0.4
    assert errors["φ_n 355°", JOINT] < 0.01


def test_lobe_narrower_than_the_grid(table: Callable) -> None:
    errors = table(stability.narrow)
    assert errors["width 0.02", FOUR] > 0.5
    assert errors["width 0.02", GGX] < 0.05


def test_saturation(table: Callable) -> None:
    """One exposure fewer: at face value the lobe is cut, left out it is kept; from three on nothing brings it back."""
    errors = table(stability.saturation)
    assert errors["4 exposures", FACE] > 0.2
    assert errors["4 exposures", "left out"] < 0.05
    assert errors["4 exposures", BOUNDED] < 0.05
    for kept in (4, 3, 2):
        assert errors[f"{kept} exposures", BOUNDED] < errors[f"{kept} exposures", FACE]
        assert errors[f"{kept} exposures", BOUNDED] < errors[f"{kept} exposures", stability.LEFT_OUT_HELD]


def test_noise(table: Callable) -> None:
    """The four steps divide by single samples, the joint fit averages."""
    errors = table(stability.noise)
    assert errors["sd 0.3", FOUR] > 0.8
    assert errors["sd 0.3", GGX] < 0.15


def test_outliers(table: Callable) -> None:
    """Least squares loses the lobe, Huber's loss keeps it, and is taken only where there are outliers."""
    errors = table(stability.outliers)
    assert errors["0 %", TRUSTED] == errors["0 %", GGX]
    assert errors["10 %", FOUR] > 2
    assert errors["10 %", GGX] > 0.3
    assert errors["10 %", TRUSTED] < 0.05


def test_needles_between_lights(table: Callable) -> None:
    errors = table(stability.needles)
    assert errors["50 lights", NEEDLES] > 0.5
    assert errors["50 lights", RESOLVED] < 0.4


def test_few_directions(table: Callable) -> None:
    """The formula of the paper explodes; what the region's texels share holds each of them."""
    errors = table(stability.few_directions)
    for lights, bound in (("100 lights", 0.1), ("50 lights", 0.3), ("30 lights", 0.5)):
        assert errors[lights, JOINT] > 2
        assert errors[lights, HELD] < bound
    assert errors["30 lights", HELD] < errors["30 lights", GGX]


def test_two_fabrics_in_a_region(table: Callable) -> None:
    """The prior has one shape for both; lights left out say how much of it to believe."""
    errors = table(stability.two_fabrics)
    assert errors["0.3 of it sharp", HELD] > 0.4
    assert errors["0.3 of it sharp", WEIGHED] < 0.1
    assert errors["0 of it sharp", WEIGHED] < 1.1 * errors["0 of it sharp", HELD]


def test_diffuse_colour_opposite_to_the_lobe(table: Callable) -> None:
    """The paper's step 2 overestimates C_d by an order of magnitude, and takes a shadow for it."""
    errors = table(stability.diffuse_colour)
    assert errors["C_d 0.01", FOUR] > 9
    assert errors["C_d 0.01", GGX] < 1
    assert errors["C_d 0.3, that side in shadow", GGX] < errors["C_d 0.3, that side in shadow", FOUR]


def test_second_lobe(table: Callable) -> None:
    errors = table(stability.second_lobe)
    assert errors["1 of the first", GGX] > 0.15
    assert errors["1 of the first", PAIR] < 0.06


def test_grazing_light(table: Callable) -> None:
    """What the lights do not reach, nobody knows; the lobes do not explode there."""
    errors = table(stability.grazing)
    assert errors["lights up to 80°", JOINT] > 0.4
    assert errors["lights up to 80°", PAIR] < 0.25
    assert max(error for (_, method), error in errors.items() if method in (PAIR, GGX)) < 0.5


def test_degenerate_texels(table: Callable) -> None:
    errors = table(stability.degenerate)
    assert errors["one NaN", FOUR] == errors["one infinity", FOUR] == np.inf
    assert np.isfinite([error for (_, method), error in errors.items() if method == GGX]).all()
    assert errors["zero", GGX] == errors["negative", GGX] == 0
    assert max(errors["one NaN", GGX], errors["one infinity", GGX]) < 0.05
    assert errors["1e6 of it", GGX] == pytest.approx(errors["1e-6 of it", GGX], rel=0.01)


def test_mixed_texels(table: Callable) -> None:
    errors = table(stability.mixed_texels)
    assert errors["0.75 silk", GGX] > 1.2 * errors["0.75 silk", PAIR]
    assert errors["0.75 silk", PAIR] < 0.03


def test_wrong_light_directions(table: Callable) -> None:
    errors = table(stability.wrong_directions)
    assert errors["1 of 20 by 20°", GGX] > 1.5 * errors["1 of 20 by 20°", TRUSTED]
    assert errors["1 of 20 by 20°", TRUSTED] < 1.2 * errors["1 of 20 by 0°", TRUSTED]


def test_lamp_drift(table: Callable) -> None:
    errors = table(stability.lamp_drift)
    assert errors["20 %", DRIFT] > 0.08
    assert errors["20 %", MONITORS] < 1.1 * errors["0 %", MONITORS]


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows as the chart reads them, and for each case what fails and what holds."""
    monkeypatch.setattr(stability, "CASES", ((stability.lamp_drift, DRIFT, MONITORS),))
    assert main(["bench", "stability", "--out", str(tmp_path / "stability.json")]) in (0, None)
    found = read_json(tmp_path / "stability.json")
    assert all(row.keys() == {"case", "parameter", "method", "error"} for row in found["rows"])
    (worst,) = found["summary"]
    assert worst["case"] == "lamp drift"
    assert worst["parameter"] == "20 %"
    assert worst["error_failing"] > 3 * worst["error_holding"]


def test_robust_loss_costs_little_without_outliers(lights: np.ndarray) -> None:
    clean = radiance(*texels(40), lights)
    samples = sampled(noisy(clean), lights)
    fits = slope.fit(samples, Lobes()), robust_weights.robust(samples, Lobes())[0]
    plain, robust = (np.median(relative(f.predict(samples.under), clean)) for f in fits)
    assert robust < 1.5 * plain


def test_prior_leaves_many_directions_alone(lights: np.ndarray) -> None:
    clean = radiance(*texels(100), lights)
    samples = sampled(noisy(clean), lights)
    priors = learned_priors.learn_priors(samples, 1, Lobes())
    free, held = (slope.fit(samples, Lobes(), p) for p in (None, priors))
    before, after = (np.median(relative(f.predict(samples.under), clean)) for f in (free, held))
    assert after < 1.5 * before + 0.005


def test_lamps_that_are_all_turned(lights: np.ndarray) -> None:
    """All lamps 3° off in azimuth: the lobes turn with them, and the error stays what the turn makes it."""
    clean = radiance(*texels(40), lights)
    theta, phi = frames.angles(lights)
    turned = frames.direction(theta, phi + np.radians(3))
    fitted = slope.fit(sampled(clean, turned), Lobes())
    assert np.median(relative(fitted.predict(Under.far(turned)), clean)) < 0.02
    mu = np.linalg.norm(fitted.shapes[:, :2], axis=1)
    assert np.abs(np.median(mu) - np.median(np.linalg.norm(texels(40)[0][:, :2], axis=1))) < 0.01


def test_the_narrower_of_two_lobes_comes_first(lights: np.ndarray) -> None:
    sharp, wide = facets(8.0, width=0.1), facets(20.0, width=0.35)
    clean = radiance(*sharp, lights, "gaussian") + radiance(wide[0], 0.3 * wide[1], lights, "gaussian")
    two = slope.fit(sampled(noisy(clean), lights), Lobes("gaussian", 2))
    assert (two.shapes[:, 2] + two.shapes[:, 4] >= two.shapes[:, 7] + two.shapes[:, 9]).all()
