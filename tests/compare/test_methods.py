"""All methods through one interface: finite, better than nothing, and blind to the held-out lights."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trials import shiny_trial, with_samples

from kinran.base import digest, encoding
from kinran.compare import errors, fitted_lobes, lobes_and_residual
from kinran.compare.method import Method, bytes_per_texel
from kinran.compare.methods import kinds, methods, of
from kinran.fit.slope_lobes import Lobes

ALL = pytest.mark.parametrize("method", methods(), ids=lambda method: method.name)


def tuned(method: Method) -> bool:
    """Whether the method's lobe is about that of the trial."""
    return method.name.startswith("GGX")


@ALL
def test_predicts_lights_that_it_has_not_seen(method: Method) -> None:
    tried = shiny_trial()
    fitted = method.fit(tried)
    predicted = fitted.predict(tried.held)
    assert predicted.shape == tried.truth.shape
    assert predicted.dtype == np.float32
    error = errors.summary(predicted, tried)["relative_error"]
    assert error < (0.1 if tuned(method) else 1.0)
    assert bytes_per_texel(fitted, tried.texels) >= 3


@ALL
def test_held_out_samples_are_not_seen(method: Method) -> None:
    tried = shiny_trial()
    blind = replace(tried, truth=np.full_like(tried.truth, np.nan), valid=np.zeros_like(tried.valid), peak=1.0)
    np.testing.assert_array_equal(method.fit(tried).predict(tried.held), method.fit(blind).predict(tried.held))


@ALL
def test_encoded_photographs(method: Method) -> None:
    tried = shiny_trial()
    bright = np.float32(4.0)
    dim = with_samples(tried, T=tried.samples.T / bright)
    dim = replace(dim, truth=tried.truth / bright, coder=encoding.parse("srgb"), clips=())
    predicted = method.fit(dim).predict(dim.held)
    assert np.isfinite(predicted).all()
    assert errors.summary(predicted, dim)["relative_error"] < 1


@ALL
def test_texels_of_a_region_that_the_cut_leaves_out(method: Method) -> None:
    tried = shiny_trial()
    away = np.full_like(tried.samples.region, 3)
    some = with_samples(tried, region=away, second=away)
    assert np.isfinite(method.fit(some).predict(tried.held)).all()


def test_bytes_count_shared_tables_by_the_texel() -> None:
    tried = shiny_trial()
    by_name = {method.name: method.fit(tried) for method in methods() if method.family == "baseline"}
    n, texels = len(tried.lights), tried.texels
    assert bytes_per_texel(by_name["PTM"], texels) == 36
    assert bytes_per_texel(by_name["PCA 8"], texels) == pytest.approx(2 * (8 + 9 * 3 * n / texels))
    assert bytes_per_texel(by_name["Delaunay"], texels) == 6 * n


def test_names_are_unique_and_families_known() -> None:
    names = [method.name for method in methods()]
    assert len(set(names)) == len(names)
    assert {method.family for method in methods()} == {"baseline", "paper", "kinran"}
    assert sorted(names) == sorted(method.name for kind in kinds() for method in of(kind))


def test_another_kind_of_method_changes_the_code_of_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each job holds the digest of its own module: a new file runs one job, and the page."""
    copy = tmp_path / "kinran"
    shutil.copytree(digest.PACKAGES["kinran"], copy, ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setitem(digest.PACKAGES, "kinran", copy)
    modules = [*(f"kinran.compare.methods.{kind}" for kind in kinds()), "kinran.compare.experiments"]

    def digests() -> list[str]:
        digest.digest.cache_clear()
        digest._read.cache_clear()
        return [digest.digest(module) for module in modules]

    before = digests()
    (copy / "compare" / "methods" / "new.py").write_text("METHODS = ()\n")
    assert digests() == before
    (copy / "compare" / "methods" / "linear.py").write_text("METHODS = ()\n")
    assert [a == b for a, b in zip(digests(), before, strict=True)].count(False) == 1


def test_two_lobes_and_a_residual_follow_what_one_lobe_cannot() -> None:
    """A second gloss on the trial: one lobe leaves it, a residual takes most of it."""
    tried = shiny_trial()

    def with_gloss(T: np.ndarray, lights: np.ndarray) -> np.ndarray:
        gloss = np.exp(-((lights[:, 0] - 0.5) ** 2 + (lights[:, 1] - 0.4) ** 2) / 0.35**2)
        return (T + 0.5 * gloss).astype(np.float32)

    shown = with_samples(tried, T=with_gloss(tried.samples.T, tried.samples.under.directions))
    shown = replace(shown, truth=with_gloss(tried.truth, tried.held.directions))
    error = [
        errors.summary(lobes_and_residual.fit(shown, Lobes("ggx", 1), count).predict(shown.held), shown)[
            "relative_error"
        ]
        for count in (0, 9)
    ]
    assert error[1] < 0.5 * error[0]


def test_a_region_has_one_shape() -> None:
    """Bytes of two slopes and two colours; in the trial regions differ in width, so one shape for both is worse."""
    tried = shiny_trial()
    (method,) = of("region_shape")
    one = np.zeros_like(tried.samples.region)
    apart, together = (
        errors.summary(method.fit(t).predict(t.held), t)["relative_error"]
        for t in (tried, with_samples(tried, region=one, second=one))
    )
    assert apart < 0.05
    assert together > 1.8 * apart
    assert bytes_per_texel(method.fit(tried), 10**6) == pytest.approx(17, abs=0.01)


def test_shared_texels_have_the_pipelines_second_prior() -> None:
    """Half a texel of the other region in a third of them, under 20 lights."""
    tried = shiny_trial()
    few = tried.under(np.arange(0, 40, 2))
    mixed = np.arange(tried.texels) % 3 == 0
    T, region = few.samples.T, few.samples.region
    few = with_samples(few, T=np.where(mixed[:, None, None], 0.5 * (T + T[::-1]), T).astype(np.float32))
    shared = with_samples(few, second=np.where(mixed, region[::-1], region))
    shapes = [fitted_lobes.fit(trial.samples, Lobes("ggx", 1)).shapes for trial in (few, shared)]
    changed = (shapes[0] != shapes[1]).any(1)
    assert changed.any()
    assert not changed[~mixed].any()
