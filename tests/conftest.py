"""Settings of all tests."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]

# results of one test are not those of another
os.environ.pop("KINRAN_CACHE", None)

# no timed tests, and the same examples in every run
settings.register_profile("kinran", deadline=None, derandomize=True)
settings.load_profile("kinran")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of whole runs first, so that none of these minutes is left for the end, and one process."""
    items.sort(key=lambda item: item.path.parent.name != "workflow")


@pytest.fixture(scope="session")
def real_data() -> Path:
    """Folder of the real data sets beside the project."""
    folder = ROOT.parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip(f"the real data sets are not at {folder}")
    return folder
