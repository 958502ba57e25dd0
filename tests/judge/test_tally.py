"""Errors that are summed tile by tile are those of all texels at once, whatever the tiles."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kinran.data import metrics
from kinran.data.held_out_photographs import HeldOut, Survey, survey
from kinran.data.labels import Region
from kinran.data.radiance import HOT, Radiance
from kinran.data.radiance_stack import Light, Metadata, Stack, write_metadata, write_shards
from kinran.judge.block_means import BlockMeans
from kinran.judge.tally import Tally

HEIGHT, WIDTH = 70, 133
"""Of a stack of six tiles, of which five are no whole chunks."""
LIGHTS = tuple(Light(f"l{i}", (0.0, np.sin(i / 7), np.cos(i / 7)), None, (1, i), i % 3 == 1) for i in range(10))
"""Lights of a grid: those at the pole stand for less of the sphere."""
REGIONS = [Region(0, "gold", 10, (0.5, 0.4, 0.1), 1.0), Region(1, "red", 20, (0.5, 0.1, 0.1), 1.0)]


def relative_error(predicted: np.ndarray, truth: np.ndarray, valid: np.ndarray, weight: np.ndarray) -> float:
    """√(Σ w (m − g)² / Σ w g²) of values (light, texel, 3)."""
    w = weight[:, None, None] * valid
    return float(np.sqrt((w * (predicted.astype(float) - truth) ** 2).sum() / (w * truth.astype(float) ** 2).sum()))


@pytest.fixture
def stack(tmp_path: Path) -> Stack:
    rng = np.random.default_rng(0)
    light = (0.02 * rng.exponential(1, (len(LIGHTS), HEIGHT, WIDTH, 3)) ** 3).astype(np.float32)
    flags = (rng.random(light.shape) < 0.01) * np.uint8(HOT)
    write_shards(tmp_path, 0, Radiance(light, flags))
    metadata = Metadata(LIGHTS, HEIGHT, WIDTH, 0.06, "", "", "camera", np.eye(3), {"kind": "raw"})
    write_metadata(tmp_path, metadata)
    return Stack.open(tmp_path)


@pytest.fixture
def whole(stack: Stack) -> HeldOut:
    return HeldOut.read(stack, (0, HEIGHT, 0, WIDTH))


def test_a_survey_in_tiles_is_exact(stack: Stack, whole: HeldOut) -> None:
    seen = survey(stack)
    assert [light.name for light in seen.lights] == ["l1", "l4", "l7"]
    assert seen.peak == pytest.approx(whole.peak, rel=1e-6)
    assert 10 * float(np.median(whole.truth)) < seen.peak < float(whole.truth.max())
    np.testing.assert_allclose(seen.mean, whole.truth.mean((1, 2, 3)), rtol=1e-5)


def test_errors_in_tiles_are_those_of_the_whole(stack: Stack, whole: HeldOut) -> None:
    """By region, light and texel, from their definitions; sound samples alone count."""
    rng, seen = np.random.default_rng(1), survey(stack)
    predicted = (whole.truth * rng.uniform(0.5, 1.7, whole.truth.shape)).astype(np.float32)
    labels = rng.integers(0, 2, (HEIGHT, WIDTH))
    tally = Tally(seen, REGIONS)
    for box in stack.tiles():
        cut = np.s_[box[0] : box[1], box[2] : box[3]]
        tally.add(HeldOut.read(stack, box, seen.peak), predicted[:, *cut], labels[cut].reshape(-1))
    found = tally.errors()

    of = [
        a.reshape(3, -1, 3) for a in (predicted, whole.truth, whole.valid, *map(whole.shown, (predicted, whole.truth)))
    ]
    for part, inside in (
        (found, labels.ravel() >= 0),
        *((found["regions"][r.name], labels.ravel() == r.label) for r in REGIONS),
    ):
        p, g, v, dp, dg = (a[:, inside] for a in of)
        decibels = [metrics.psnr(dp[i], dg[i], v[i]) for i in range(3)]
        assert part["psnr"] == pytest.approx(np.mean(decibels), abs=2e-3)
        assert part["psnr_min"] == pytest.approx(min(decibels), abs=2e-3)
        assert part["relative_error"] == pytest.approx(relative_error(p, g, v, whole.share), abs=2e-5)
    p, g, v = of[:3]
    texel = [relative_error(p[:, [k]], g[:, [k]], v[:, [k]], whole.share) for k in range(p.shape[1])]
    assert found["texel_median"] == pytest.approx(np.median(texel), abs=2e-5)
    assert found["texel_p95"] == pytest.approx(np.percentile(texel, 95), abs=2e-5)
    one = found["lights"]["l4"]
    assert one["relative_error"] == pytest.approx(relative_error(p[[1]], g[[1]], v[[1]], np.ones(1)), abs=2e-5)


def test_a_perfect_prediction_has_no_error(stack: Stack, whole: HeldOut) -> None:
    seen = Survey(whole.lights, whole.share, whole.peak, whole.truth.mean((1, 2, 3)))
    tally = Tally(seen, REGIONS)
    tally.add(whole, whole.truth, np.zeros(HEIGHT * WIDTH, int))
    found = tally.errors()
    assert (found["psnr"], found["relative_error"], found["texels_above_1"]) == (120, 0, 0)


def test_texels_that_glow_where_their_photograph_does_not(stack: Stack, whole: HeldOut) -> None:
    """Above white and twice the photograph; a bright photograph under the same light makes no fault of it."""
    tally = Tally(Survey(whole.lights, whole.share, whole.peak, whole.truth.mean((1, 2, 3))), REGIONS)
    held = replace(whole, truth=np.full_like(whole.truth, 0.3), valid=np.ones_like(whole.valid))
    held.truth[:, 0, :10] = 0.9
    predicted = held.truth.copy()
    predicted[1, 0, :20, 2] = 1.5
    predicted[0, 1, :20] = 0.9
    tally.add(held, predicted, np.zeros(HEIGHT * WIDTH, int))
    assert tally.errors()["texels_above_white"] == pytest.approx(10 / (HEIGHT * WIDTH), abs=1e-6)


def test_without_a_sound_sample_nothing_is_wrong(whole: HeldOut) -> None:
    """All held-out photographs are saturated, say: the errors are numbers all the same."""
    seen = Survey(whole.lights, whole.share, whole.peak, whole.truth.mean((1, 2, 3)))
    tally = Tally(seen, REGIONS)
    nothing = replace(whole, truth=np.zeros_like(whole.truth), valid=np.zeros_like(whole.valid))
    tally.add(nothing, whole.truth + 9, np.zeros(HEIGHT * WIDTH, int))
    found = tally.errors()
    assert (found["relative_error"], found["texel_median"], found["texels_above_white"]) == (0, 0, 0)


@pytest.mark.parametrize("step", [1, 3, 200])
def test_means_of_blocks_that_tiles_cut(stack: Stack, step: int) -> None:
    images = np.random.default_rng(2).random((2, HEIGHT, WIDTH, 3)).astype(np.float32)
    means = BlockMeans(images.shape, step)
    for y0, y1, x0, x1 in stack.tiles():
        means.add((y0, y1, x0, x1), images[:, y0:y1, x0:x1])
    found = means.images()
    for y, x in ((0, 0), (found.shape[1] - 1, found.shape[2] - 1), (found.shape[1] // 2, found.shape[2] // 3)):
        block = images[:, y * step : (y + 1) * step, x * step : (x + 1) * step]
        np.testing.assert_allclose(found[:, y, x], block.mean((1, 2)), rtol=1e-5)
    assert found.shape == (2, -(-HEIGHT // step), -(-WIDTH // step), 3)


def test_more_light_than_a_saturated_sample_is_no_error(whole: HeldOut) -> None:
    truth = np.full_like(whole.truth, 0.5)
    truth[:, :10] = 1
    held = replace(whole, truth=truth, valid=np.ones_like(whole.valid), full=truth >= 1)
    found = []
    for predicted in (truth, truth * np.where(truth >= 1, 3, 1), truth * np.where(truth >= 1, 0.8, 1), truth * 1.2):
        tally = Tally(Survey(whole.lights, whole.share, 1.0, truth.mean((1, 2, 3))), REGIONS)
        tally.add(held, predicted.astype(np.float32), np.zeros(HEIGHT * WIDTH, int))
        found.append(tally.errors()["relative_error"])
        assert (tally.errors()["texels_above_white"] > 0) == (predicted.max() > 2)  # a spark is one all the same
    assert found[:2] == [0, 0]
    assert found[2] > 0.1
    dark = (0.1**2 * 60 / (0.5**2 * 60 + 10)) ** 0.5  # the saturated rows count as energy, not as error
    assert found[3] == pytest.approx(dark, abs=1e-4)
