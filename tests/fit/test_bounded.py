"""Saturated samples as lower bounds: never taken at face value."""

from pathlib import Path

import numpy as np
from synthetic_texels import grid, radiance, texels

from kinran.fit import bounded, samples, slope
from kinran.stack import SATURATED, Light, Stack, write_metadata, write_shards

COUNT = 100
NO_REGION = np.zeros(COUNT, np.intp)


def clipped(share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples cut so that about this share of them is saturated, where that is, lights."""
    lights = grid(10, 24)
    T = radiance(*texels(COUNT), lights, "gaussian")
    level = np.quantile(T.max(1), 1 - share, axis=1)[:, None, None]
    return np.minimum(T, level), (level <= T).any(1), lights


def peak_error(fitted: slope.SlopeFit, truth: np.ndarray) -> float:
    colours = fitted.colours[:, 0, 0]
    return float(np.median(np.abs(colours / truth - 1)))


def test_bounds_find_the_peak_that_was_cut_off() -> None:
    """5 % of the samples are cut: at a weight of 0.2 they pull the peak down by 7 %, as bounds by 2 %."""
    T, saturated, lights = clipped(0.05)
    truth = texels(COUNT)[1][:, 0, 0]
    W = np.where(saturated, 0.2, 1).astype(np.float32)
    bounds = saturated.astype(np.float32)
    half = lights[:, :2] / (1 + lights[:, 2:])
    first = slope.fit(T, W, lights, "gaussian")
    again = bounded.refit(first, T, W, bounds, 1.0, lights, "gaussian", 1, None, NO_REGION, 1, half)
    assert peak_error(first, truth) > 0.05
    assert peak_error(again, truth) < 0.5 * peak_error(first, truth)


def test_texels_with_more_keep_their_fit() -> None:
    T, saturated, lights = clipped(0.02)
    W = np.where(saturated, 0, 1).astype(np.float32)
    saturated[:50] |= np.arange(len(lights)) % 5 == 0
    half = lights[:, :2] / (1 + lights[:, 2:])
    first = slope.fit(T, W, lights, "gaussian")
    bounds = saturated.astype(np.float32)
    again = bounded.refit(first, T, W, bounds, 0.03, lights, "gaussian", 1, None, NO_REGION, 1, half)
    np.testing.assert_array_equal(again.shapes[:50], first.shapes[:50])
    assert (again.shapes[50:] != first.shapes[50:]).any(1).mean() > 0.5


def test_bounds_of_a_stack(tmp_path: Path) -> None:
    """Only where a sample is saturated and no defect; none at all where nothing is."""
    lights = [Light(f"l{k}", (0.1 * k, 0.0, (1 - 0.01 * k * k) ** 0.5)) for k in range(4)]
    flags = np.zeros((4, 2, 2, 3), np.uint8)
    for name, bits in (("none", 0), ("some", SATURATED)):
        flags[1, 0, 1, 2] = bits
        write_shards(tmp_path / name, 0, np.full(flags.shape, 0.5, np.float32), flags)
        write_metadata(tmp_path / name, lights, 2, 2, None, "", "", "camera", np.eye(3), {"kind": "none"})
    assert samples.read(Stack.open(tmp_path / "none"), (0, 2, 0, 2)).bounds is None
    tile = samples.read(Stack.open(tmp_path / "some"), (0, 2, 0, 2))
    assert tile.bounds is not None
    expected = np.zeros((4, 4), np.float32)
    expected[1, 1] = 1
    np.testing.assert_array_equal(tile.bounds, expected)
    np.testing.assert_array_equal(tile.W, 1 - expected)
