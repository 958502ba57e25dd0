"""The measures of the chart on predictions whose error is known."""

from dataclasses import replace

import numpy as np
import pytest
from trials import shiny_trial

from kinran.compare import errors


def test_a_perfect_prediction() -> None:
    tried = shiny_trial()
    found = errors.summary(tried.truth, tried)
    assert found["relative_error"] == found["log_error"] == found["texel_p95"] == 0
    assert found["psnr_linear"] == found["psnr_display"] == pytest.approx(120)
    assert found["ssim_linear"] == found["ssim_display"] == pytest.approx(1)


def test_ten_per_cent_too_bright() -> None:
    tried = shiny_trial()
    found = errors.summary(tried.truth * np.float32(1.1), tried)
    assert found["relative_error"] == pytest.approx(0.1, rel=1e-4)
    assert found["texel_median"] == pytest.approx(0.1, rel=1e-4)
    assert 0.8 * np.log(1.1) < found["log_error"] < np.log(1.1)  # ε softens the darkest
    assert found["texels_above_1"] == 0
    assert 0.9 < found["ssim_linear"] < 1


def test_relative_error_weighs_highlights_and_log_error_the_dark() -> None:
    tried = shiny_trial()
    dark = tried.truth < np.median(tried.truth)
    in_the_dark = errors.summary(np.where(dark, 2 * tried.truth, tried.truth), tried)
    in_the_light = errors.summary(np.where(dark, tried.truth, 2 * tried.truth), tried)
    assert in_the_dark["relative_error"] < 0.1 * in_the_light["relative_error"]
    assert in_the_dark["log_error"] > 0.6 * in_the_light["log_error"]


def test_what_is_not_valid_does_not_count() -> None:
    tried = shiny_trial()
    predicted, valid = tried.truth.copy(), tried.valid.copy()
    predicted[5, 1, 2], valid[5, 1, 2] = 1e6, False
    found = errors.summary(predicted, replace(tried, valid=valid))
    assert found["relative_error"] == 0
    assert found["psnr_display"] == pytest.approx(120)


def test_one_exploded_texel_shows() -> None:
    tried = shiny_trial()
    predicted = tried.truth.copy()
    predicted[3] *= 100
    found = errors.summary(predicted, tried)
    assert found["texels_above_1"] == pytest.approx(1 / tried.texels)
    assert found["texel_median"] == 0
    assert found["relative_error"] > 1


def test_pictures_are_colour_corrected() -> None:
    """An error in a channel that the matrix drops is not seen in the picture."""
    tried = replace(shiny_trial(), to_rec709=np.diag([1.0, 1.0, 0.0]))
    predicted = tried.truth.copy()
    predicted[:, 2] *= 2
    found = errors.summary(predicted, tried)
    assert found["psnr_display"] == pytest.approx(120)
    assert found["relative_error"] > 0.1


def test_part_of_a_map_has_no_picture() -> None:
    tried = shiny_trial().thinned(20)
    assert "psnr_display" not in errors.summary(tried.truth, tried)


def test_bands_and_regions() -> None:
    tried = shiny_trial()
    predicted = tried.truth.copy()
    predicted[tried.samples.region == 1] *= 1.5
    regions = errors.by_region(predicted, replace(tried, regions=("gold", "red", "blue")))
    assert regions == {"gold": 0, "red": pytest.approx(0.5, rel=1e-4)}
    steep = np.degrees(np.arccos(tried.held.directions[:, 2])) > 50
    predicted = tried.truth.copy()
    predicted[:, :, steep] *= 1.2
    bands = errors.by_band(predicted, tried)
    assert list(bands) == ["0–30°", "30–50°", "50–65°", "65–90°"]
    assert bands["0–30°"] == bands["30–50°"] == 0
    assert bands["65–90°"] == pytest.approx(0.2, rel=1e-4)


def test_similarity_falls_with_noise_and_with_shift() -> None:
    rng = np.random.default_rng(0)
    image = np.clip(np.add.outer(np.sin(np.arange(40) / 3), np.cos(np.arange(40) / 4)) / 4 + 0.5, 0, 1)
    noisy = [errors.ssim(image, image + rng.normal(0, sd, image.shape)) for sd in (0.01, 0.05, 0.2)]
    assert 1 > noisy[0] > noisy[1] > noisy[2]
    assert errors.ssim(image, np.roll(image, 4, 0)) < 0.9


def test_criteria_weigh_the_residual_against_the_numbers() -> None:
    """A residual e times as large costs n; a number costs 2 or ln n. What goes through its samples has none."""
    tried = shiny_trial()
    T = tried.samples.T
    n = T[0].size
    noise = np.random.default_rng(0).normal(0, 0.01, T.shape).astype(np.float32)
    small, large = (errors.criteria(T + scale * noise, tried, 10) for scale in (1, np.float32(np.e)))
    assert large["aic"] - small["aic"] == pytest.approx(2 * n, rel=1e-3)
    more = errors.criteria(T + noise, tried, 11)
    assert more["aic"] - small["aic"] == pytest.approx(2, abs=1e-6)
    assert more["bic"] - small["bic"] == pytest.approx(np.log(n), abs=1e-6)
    assert errors.criteria(T, tried, 10) == {}


def test_more_light_than_a_saturated_sample_is_no_error() -> None:
    tried = shiny_trial()
    full = tried.truth > np.median(tried.truth)
    shown = replace(tried, full=full)
    brighter = np.where(full, 2 * tried.truth, tried.truth)
    assert errors.summary(brighter, tried)["relative_error"] > 0.9
    assert errors.summary(brighter, shown)["relative_error"] == 0
    assert errors.summary(np.where(full, 0.5 * tried.truth, tried.truth), shown)["relative_error"] > 0.4
