"""What several tests of the rig share."""

import ctypes

import pytest
from c_rig import build


@pytest.fixture(scope="session")
def c_rig(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The firmware in C around its simulated rig."""
    return build(tmp_path_factory.mktemp("firmware"))
