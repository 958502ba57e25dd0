"""Autoencoders: what they are trained on, they give back; what has no weight, they do not see."""

import numpy as np
import pytest
from synthetic_texels import sampled

from kinran.base import frames
from kinran.base.probes import variant_fault
from kinran.compare.baselines import neural
from kinran.data.texel_directions import Under

LIGHTS = frames.direction(np.radians(np.repeat([20.0, 40, 60], 8)), 2 * np.pi * np.tile(np.arange(8), 3) / 8)

pytestmark = pytest.mark.skipif(bool(variant_fault("llvm_ad_rgb")), reason="Dr.Jit has no LLVM here")


def facets(count: int) -> np.ndarray:
    """Values (texel, 3, light) of tilted facets in three colours."""
    rng = np.random.default_rng(0)
    normals = frames.direction(rng.uniform(0, 0.6, count), rng.uniform(0, 2 * np.pi, count))
    colours = rng.uniform(0.2, 0.8, (count, 3, 1))
    return (colours * np.maximum(normals @ LIGHTS.T, 0)[:, None]).astype(np.float32)


def test_it_learns_facets_and_keeps_nine_numbers() -> None:
    T = facets(300)
    found = neural.fit(sampled(T, LIGHTS), neural.SMALL, 600)
    error = found.predict(Under.far(LIGHTS, len(T))) - T
    spread = T - T.mean(0)
    assert np.square(error).mean() < 0.1 * np.square(spread).mean()
    assert found.numbers == 9
    assert found.shared == 12 * 50 + 51 * 50 + 51 * 3


def test_it_is_the_same_each_time() -> None:
    one, two = (neural.fit(sampled(facets(50), LIGHTS), neural.SMALL, 20) for _ in range(2))
    np.testing.assert_allclose(one.codes, two.codes, atol=1e-4)


def test_samples_without_weight_do_not_train_the_decoder() -> None:
    T, W = facets(200), np.ones((200, len(LIGHTS)), np.float32)
    T[:, :, 5], W[:, 5] = 5.0, 0
    found = neural.fit(sampled(T, LIGHTS, W), neural.SMALL, 200)
    assert found.predict(Under.far(LIGHTS[[5]], len(T))).max() < 2


def test_the_decoder_of_neural_rti_is_as_wide_as_its_samples() -> None:
    found = neural.KINDS["NeuralRTI"](sampled(facets(20), LIGHTS), 2)
    assert [weights.shape for weights, _ in found.decoder] == [(72, 11), (72, 72), (72, 72), (3, 72)]
