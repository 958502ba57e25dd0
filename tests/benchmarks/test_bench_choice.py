"""The benchmark of what a byte has to gain."""

from dataclasses import replace

import numpy as np
import pytest
from trials import shiny_trial, with_samples

from benchmarks import choice


def test_dearer_bytes_buy_fewer_and_what_is_lost_is_said() -> None:
    """A second lobe that half a decibel of the held-out error pays for: taken while bytes are cheap."""
    tried = shiny_trial()
    found = choice.measure(tried)
    sizes = [at["bytes"] for at in found["costs"].values()]
    assert sizes == sorted(sizes, reverse=True)
    best = max(*found["alone"].values(), *(at["psnr"] for at in found["costs"].values()))
    for at in found["costs"].values():
        assert at["lost"] == pytest.approx(best - at["psnr"])
        assert len(at["chosen"]) == 2


def test_a_region_without_a_lobe_is_joined_as_such() -> None:
    """A matte region: the lobes of the shiny one and the cosine of the other."""
    tried = shiny_trial()
    matte = tried.samples.region == 1
    T, truth = (
        np.where(matte[:, None, None], 0.3 * under.directions[:, 2], values).astype(np.float32)
        for values, under in ((tried.samples.T, tried.samples.under), (tried.truth, tried.held))
    )
    found = choice.measure(replace(with_samples(tried, T=T), truth=truth))
    at = found["costs"]["0.3"]
    assert at["chosen"] == ["one GGX lobe", "lambert"]
    assert at["bytes"] == pytest.approx(26 * np.mean(~matte) + 10 * np.mean(matte))
    assert at["lost"] < 0.1
