"""All methods through one interface: finite, better than nothing, and blind to the held-out lights."""

from dataclasses import replace

import numpy as np
import pytest
from trials import shiny_trial

from kinran import encoding
from kinran.chart import errors
from kinran.chart.methods import Method, methods

ALL = pytest.mark.parametrize("method", methods(), ids=lambda method: method.name)


def tuned(method: Method) -> bool:
    """Whether the method's lobe is about that of the trial."""
    return method.name.startswith("GGX")


@ALL
def test_predicts_lights_that_it_has_not_seen(method: Method) -> None:
    tried = shiny_trial()
    fitted = method.fit(tried)
    predicted = fitted.predict(tried.held_out)
    assert predicted.shape == tried.truth.shape
    assert predicted.dtype == np.float32
    error = errors.summary(predicted, tried)["relative_error"]
    assert error < (0.1 if tuned(method) else 1.0)
    assert fitted.bytes_per_texel(tried.texels) >= 3


@ALL
def test_held_out_samples_are_not_seen(method: Method) -> None:
    tried = shiny_trial()
    blind = replace(tried, truth=np.full_like(tried.truth, np.nan), valid=np.zeros_like(tried.valid), peak=1.0)
    np.testing.assert_array_equal(method.fit(tried).predict(tried.held_out), method.fit(blind).predict(tried.held_out))


@ALL
def test_encoded_photographs(method: Method) -> None:
    tried = shiny_trial()
    bright = np.float32(4.0)
    dim = replace(tried, T=tried.T / bright, truth=tried.truth / bright, coder=encoding.parse("srgb"), clips=())
    predicted = method.fit(dim).predict(dim.held_out)
    assert np.isfinite(predicted).all()
    assert errors.summary(predicted, dim)["relative_error"] < 1


@ALL
def test_texels_of_a_region_that_the_cut_leaves_out(method: Method) -> None:
    tried = shiny_trial()
    some = replace(tried, region=np.full_like(tried.region, 3))
    assert np.isfinite(method.fit(some).predict(tried.held_out)).all()


def test_bytes_count_shared_tables_by_the_texel() -> None:
    tried = shiny_trial()
    by_name = {method.name: method.fit(tried) for method in methods() if method.family == "baseline"}
    n, texels = len(tried.lights), tried.texels
    assert by_name["PTM"].bytes_per_texel(texels) == 36
    assert by_name["PCA 8"].bytes_per_texel(texels) == pytest.approx(2 * (8 + 9 * 3 * n / texels))
    assert by_name["Delaunay"].bytes_per_texel(texels) == 6 * n


def test_names_are_unique_and_families_known() -> None:
    names = [method.name for method in methods()]
    assert len(set(names)) == len(names)
    assert {method.family for method in methods()} == {"baseline", "paper", "kinran"}
