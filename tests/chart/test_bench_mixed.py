"""The benchmark of texels that two threads share."""

from dataclasses import replace

import numpy as np
from trials import SHAPE, shiny_trial

from kinran.bench import mixed


def test_pure_texels_keep_their_error_and_mixed_ones_gain() -> None:
    """Under 20 lights, with half a texel of the other region in a third of them."""
    tried = shiny_trial()
    is_mixed = np.arange(tried.texels) % 3 == 0

    def halved(values: np.ndarray) -> np.ndarray:
        blend = 0.3 * values + 0.7 * values[::-1]
        return np.where(is_mixed[:, None, None], blend, values).astype(np.float32)

    tried = replace(tried, T=halved(tried.T), truth=halved(tried.truth))
    few = tried.under(np.arange(0, 40, 2))
    few = replace(few, second=np.where(is_mixed, few.region[::-1], few.region))
    own, shared = mixed.measure(few, np.where(is_mixed, 0.5, 1.0))
    assert shared["purity 0-0.7"] < own["purity 0-0.7"]
    assert shared["purity 0.9-1"] == own["purity 0.9-1"]


def test_coarse_texels_are_means() -> None:
    tried = shiny_trial()
    labels = np.zeros((SHAPE[0] // 2, SHAPE[1] // 2), np.intp)
    wide = mixed.coarse(tried, 2, labels, labels + 1)
    assert wide.texels == labels.size == len(wide.region) == len(wide.second)
    first = tried.T.reshape(*SHAPE, *tried.T.shape[1:])[:2, :2].mean((0, 1))
    np.testing.assert_allclose(wide.T[0], first, rtol=1e-6)
    assert wide.valid.all()
