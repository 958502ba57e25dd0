"""Lights of the tests."""

import numpy as np
import pytest
from synthetic_texels import grid


@pytest.fixture(scope="session")
def lights() -> np.ndarray:
    return grid()
