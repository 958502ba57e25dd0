"""Shutter times: as cameras name them, as files name them, and as pictures tell them."""

import numpy as np
import pytest
from raw_frames import GAIN, READ, TRUE, expose, scene

from kinran.base.files import InputError
from kinran.bracket.estimator import ratio_sums
from kinran.bracket.exposures import curtain, curtain_of, parse_times, third_stop
from kinran.bracket.noise import measure_noise, rounding
from kinran.data.calibration import Response
from kinran.data.nominal_time import time_in_name

RESPONSE = Response(3470, GAIN, float(np.hypot(READ, 12**-0.5)))


@pytest.mark.parametrize(
    ("nominal", "true"),
    [(1 / 25, 1 / 25.4), (1 / 100, 1 / 101.6), (1 / 4000, 1 / 4096), (1 / 60, 1 / 64), (30, 32), (3.916, 3.916)],
)
def test_third_stops(nominal: float, true: float) -> None:
    """A time of the dial is a power of 2^(1/3); one that no dial has stays."""
    assert third_stop(nominal) == pytest.approx(true, rel=1e-3)
    assert third_stop(third_stop(nominal)) == pytest.approx(third_stop(nominal), rel=1e-9)


def test_times_in_words() -> None:
    assert parse_times("1/25, 0.01,2") == [0.04, 0.01, 2.0]
    for text in ("", "1/0", "-1", "1,,2", "fast", "inf"):
        with pytest.raises(InputError, match="times"):
            parse_times(text)


@pytest.mark.parametrize(
    ("stem", "seconds"),
    [("cloth_25ms", 0.025), ("a_1-250s_x", 0.004), ("a_0.5s", 0.5), ("d2_550nm_3916ms_2019-02", 3.916), ("a_25", 0.0)],
)
def test_times_in_names(stem: str, seconds: float) -> None:
    assert time_in_name(stem) == pytest.approx(seconds)


def planes(banding: float = 0.0, seed: int = 0) -> np.ndarray:
    """Bracket (5, 4, 96, 96) of a scene whose four sites are alike, its shortest exposure banded along the rows."""
    rng, light = np.random.default_rng(seed), scene(96)[::2, ::2]
    band = 1 + banding * np.linspace(-1, 1, 96)[:, None]
    times = [value * (band if rate == 4000 else np.ones_like(band)) for rate, value in TRUE.items()]
    return np.stack([[expose(light, time, rng) for _ in range(4)] for time in times])


def test_the_curtain_is_found_where_there_is_one() -> None:
    """3 % from the middle to the edge, to 0.4 %; none where there is none."""
    black = np.full((5, 4, 96), 256.0)
    even, banded = planes(), planes(0.03)
    for longer in range(4):
        assert curtain_of(ratio_sums(even, black, longer, RESPONSE.clip), RESPONSE) == ()
    shape = curtain(curtain_of(ratio_sums(banded, black, 3, RESPONSE.clip), RESPONSE), 96)
    np.testing.assert_allclose(shape, 1 + 0.03 * np.linspace(-1, 1, 96), atol=4e-3)


def test_noise_from_any_scene() -> None:
    """Gain to 3 %, read noise to 5 %, from a scene with edges; of one frame to 15 % where it is smooth."""
    bracket, black = planes(), np.full((5, 4, 96), 256.0)
    seconds = np.repeat(np.array(list(TRUE.values()))[:, None], 96, 1)
    gain, read, coding = measure_noise(bracket, black, seconds, RESPONSE.clip)
    assert gain == pytest.approx(GAIN, rel=0.03)
    assert read == pytest.approx(RESPONSE.read, rel=0.05)
    assert coding == 0
    gain, read, coding = measure_noise(bracket[2:3], black[2:3], seconds[2:3], RESPONSE.clip)
    assert gain == pytest.approx(GAIN, rel=0.15)
    assert read == pytest.approx(RESPONSE.read, rel=0.15)


def test_rounding_of_eight_bits() -> None:
    steps = (np.arange(256, dtype=np.uint16) * 257).repeat(9).reshape(1, 1, 48, 48)
    assert rounding(steps) == pytest.approx(257 / np.sqrt(12))
    assert rounding(np.arange(2304, dtype=np.uint16).reshape(1, 1, 48, 48)) == pytest.approx(3 / np.sqrt(12))
