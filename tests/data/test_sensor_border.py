"""The border of a sensor beside its picture."""

from dataclasses import replace

import numpy as np
import pytest

from kinran.data.raw import RawFrame
from kinran.data.sensor_border import Border, read_border

ROWS, COLUMNS, READ = 600, 42, 1.65
SITES = [(0, 0), (0, 1), (1, 0), (1, 1)]


def border(drift: np.ndarray | float = 0.0, seed: int = 0, hot: int = 0) -> Border:
    """Border of 42 masked columns and 8 masked rows, whose rows drift."""
    rng = np.random.default_rng(seed)
    counts = rng.normal(256, READ, (8 + ROWS, COLUMNS + 60))
    counts[8:] += np.broadcast_to(drift, ROWS)[:, None]
    counts[8:, COLUMNS:] += 500
    counts[rng.integers(0, 8 + ROWS, hot), rng.integers(0, COLUMNS, hot)] += 300
    found = read_border(np.floor(counts + 0.5).astype(np.uint16), (8, COLUMNS), (8, ROWS), SITES)
    assert found is not None
    return found


def wave(size: float, turns: float) -> np.ndarray:
    return np.asarray(size * np.sin(2 * np.pi * (np.linspace(0, turns, ROWS) + 0.2)))


@pytest.mark.parametrize("turns", [0.7, 2.3, 40])
@pytest.mark.parametrize("hot", [0, 200])
def test_drift_is_found_under_the_noise_of_a_row(turns: float, hot: int) -> None:
    """Waves of half a count, twice the noise of a row's mean, to a quarter."""
    true = wave(0.5, turns) - wave(0.5, turns).mean()
    assert np.std(border(true, hot=hot).drift - true) < 0.12 < 0.3 < np.std(true)


def test_jumps_from_row_to_row_are_halved_where_they_exceed_the_noise() -> None:
    true = np.random.default_rng(5).normal(0, 0.8, ROWS)
    assert np.std(border(true).drift - true) < 0.3


def test_nothing_is_added_where_nothing_drifts() -> None:
    """The failure: the rows' means themselves have a noise of 0.25 counts."""
    found = [border(seed=seed).drift for seed in range(20)]
    assert sum(drift.any() for drift in found) <= 2
    assert np.std(found) < 0.03


def test_a_band_beside_that_is_lit_is_not_used() -> None:
    """The last ten columns before the picture see some light; levels and drift come from the others."""
    counts = np.random.default_rng(1).normal(256, READ, (8 + ROWS, COLUMNS + 60))
    counts[:, 32:COLUMNS] += 20 + 10 * np.linspace(0, 1, 8 + ROWS)[:, None]
    found = read_border(np.floor(counts + 0.5).astype(np.uint16), (8, COLUMNS), (8, ROWS), SITES)
    assert found is not None
    np.testing.assert_allclose(found.levels, 256, atol=0.1)
    assert np.abs(found.drift).max() < 0.1


REVERSED = slice(None, None, -1)


@pytest.mark.parametrize(("orientation", "rows"), [(1, slice(None)), (2, slice(None)), (3, REVERSED), (4, REVERSED)])
def test_drift_turns_with_the_picture(orientation: int, rows: slice) -> None:
    """Each row keeps the level that it had on the sensor."""
    drift = np.arange(4 * 5, dtype=float).reshape(4, 5)
    frame = RawFrame(np.repeat(drift[..., None], 7, 2).astype(np.uint16), np.zeros(4), np.zeros(4), drift, 4095, 1)
    turned = replace(frame, orientation=orientation).upright()
    assert turned.drift is not None
    np.testing.assert_array_equal(turned.drift, drift[:, rows])
    np.testing.assert_array_equal(turned.planes, np.repeat(turned.drift[..., None], 7, 2))


@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_rows_that_become_columns_have_no_drift(orientation: int) -> None:
    frame = RawFrame(np.zeros((4, 5, 7), np.uint16), np.zeros(4), np.zeros(4), np.ones((4, 5)), 4095, 1)
    turned = replace(frame, orientation=orientation).upright()
    assert (turned.planes.shape, turned.drift) == ((4, 7, 5), None)
