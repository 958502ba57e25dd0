"""Encodings of light."""

import numpy as np
import pytest

from kinran.base.encoding import parse
from kinran.base.files import InputError


@pytest.mark.parametrize("name", ["srgb", "linear", "gamma:2.2", "gamma:1.8"])
def test_encode_inverts_decode(name: str) -> None:
    values = np.linspace(0, 1, 256)
    np.testing.assert_allclose(parse(name).encode(parse(name).decode(values)), values, atol=1e-6)


def test_srgb_known_values() -> None:
    np.testing.assert_allclose(parse("srgb").decode([0.5, 0.04045]), [0.214041, 0.0031308], rtol=1e-4)


@pytest.mark.parametrize("name", ["srgb", "gamma:2.2"])
def test_weight_is_the_squared_slope_of_the_encoding(name: str) -> None:
    """Up to a constant and away from black, where it is softened on purpose."""
    light = np.linspace(0.2, 0.9, 50)
    slope = (parse(name).encode(light + 1e-3) - parse(name).encode(light - 1e-3)) / 2e-3
    ratio = parse(name).weight(light) / slope**2
    assert ratio.max() / ratio.min() < 1.2


@pytest.mark.parametrize("name", ["", "sRGB", "gamma", "gamma:", "gamma:x", "gamma:0", "gamma:nan", "gamma:9"])
def test_unknown_encodings(name: str) -> None:
    with pytest.raises(InputError, match=r"give srgb, linear or gamma:EXPONENT"):
        parse(name)
