"""Which frame belongs to which exposure."""

import pytest

from kinran.capture.frame_check import complaint, match, same_aperture, same_setting
from kinran.rig.camera import FrameFacts

NOMINAL = (
    (1 / 30, 1 / 32),
    (1 / 60, 1 / 64),
    (1 / 125, 1 / 128),
    (1 / 4000, 1 / 4096),
    (1 / 13, 1 / 12.7),
    (0.3, 0.315),
)
THIRDS = (1 / 4000, 1 / 3200, 1 / 2500, 1 / 2000, 1 / 160, 1 / 125, 1 / 100, 1 / 25, 1 / 20, 0.3, 0.4, 1.0, 1.3)


@pytest.mark.parametrize(("said", "asked"), NOMINAL)
def test_nominal_times_are_the_exact_ones(said: float, asked: float) -> None:
    assert same_setting(said, asked)


def test_neighbouring_times_are_not_confused() -> None:
    for a in THIRDS:
        assert [b for b in THIRDS if same_setting(a, b)] == [a]


def test_apertures() -> None:
    assert same_aperture(5.6, 5.66)
    assert not same_aperture(5.6, 6.3)
    assert same_aperture(0, 8)


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        (FrameFacts(1 / 100, 100, 8), ""),
        (FrameFacts(1 / 250, 100, 8), "exposure is 1/250 s"),
        (FrameFacts(0.0, 100, 8), "exposure is not stated"),
        (FrameFacts(1 / 100, 200, 8), "ISO is 200 instead of 100"),
        (FrameFacts(1 / 100, 100, 5.6), "aperture is f/5.6 instead of f/8"),
    ],
)
def test_complaints(facts: FrameFacts, words: str) -> None:
    said = complaint(facts, 1 / 100, 100, 8)
    assert words in said
    assert bool(words) == bool(said)


def test_frames_find_their_exposures_in_any_order() -> None:
    frames = [FrameFacts(1 / 1000), FrameFacts(1 / 25), FrameFacts(1 / 250)]
    own, others = match({0: 1 / 25, 1: 1 / 250, 2: 1 / 1000}, frames)
    assert own == {0: 1, 1: 2, 2: 0}
    assert others == {}


def test_two_frames_of_one_exposure_are_both_refused() -> None:
    own, others = match({0: 1 / 25, 1: 1 / 250}, [FrameFacts(1 / 25), FrameFacts(1 / 25), FrameFacts(1 / 250)])
    assert own == {1: 2}
    assert set(others) == {0, 1}


def test_a_frame_of_an_earlier_exposure_is_late() -> None:
    frames = [FrameFacts(1 / 25, taken=99.0), FrameFacts(1 / 25, taken=100.0), FrameFacts(1 / 25, taken=0.0)]
    assert match({0: 1 / 25}, frames[:2], since=100.0)[0] == {0: 1}
    assert "late" in match({0: 1 / 25}, frames[:1], since=100.0)[1][0]
    assert match({0: 1 / 25}, frames[2:], since=100.0)[0] == {0: 0}
