"""What a set will cost is said before it runs, and what makes it cheaper."""

import re

import pytest

from kinran.capture.photograph_set import Known, PhotographSet
from kinran.data.light import LpLight
from kinran.run.cost_of_a_set import predicted


def of(width: int, height: int, lights: int = 60) -> PhotographSet:
    return PhotographSet([LpLight(f"l{k}", (0, 0, 1), 1.0) for k in range(lights)], (width, height))


def test_a_small_set_is_a_sentence() -> None:
    (said,) = predicted(of(400, 300), Known())
    assert re.fullmatch(
        r"60 lights of 0.12 megapixels: about \d+ min of CPU time, \d+ MB of memory and \d+ MB of disk", said
    )


def test_a_megapixel_of_60_photographs() -> None:
    """506 CPU seconds were measured: 19 of them outside of stages."""
    (said,) = predicted(of(1250, 800), Known())
    minutes = re.search(r"about (\d+) min", said)
    assert minutes
    assert int(minutes[1]) in (7, 8, 9, 10)


def test_what_takes_over_an_hour_comes_with_a_proposal_that_does_not() -> None:
    cost, proposal = predicted(of(6000, 4000), Known())
    assert re.search(r"about [\d.]+ h of CPU time, [\d.]+ GB of memory", cost)
    most = re.search(r"--max-mp ([\d.]+) takes about \d+ min", proposal)
    assert most
    (cheaper,) = predicted(of(6000, 4000), Known(max_mp=float(most[1])))
    assert " min of CPU time" in cheaper
    assert "pixels make a texel" in cheaper


def test_a_crop_counts() -> None:
    assert len(predicted(of(6000, 4000), Known(crop="0,0,600,400"))) == 1


@pytest.mark.parametrize(("max_mp", "pixels"), [(24, 1), (23.9, 2), (6, 2), (5.9, 3)])
def test_whole_numbers_of_pixels_make_a_texel(max_mp: float, pixels: int) -> None:
    said = predicted(of(6000, 4000), Known(max_mp=max_mp))[0]
    assert (f"{pixels} × {pixels} pixels" in said) == (pixels > 1)
