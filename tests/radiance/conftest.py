"""One capture for all tests of the room."""

import pytest
from known_scene import EXPOSURES, Capture, shoot

from kinran.base.distances import Distances
from kinran.capture.assembly import Rig
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import write_plan


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """Twelve directions and θ = 0, spread in two groups, with calibration."""
    folder = tmp_path_factory.mktemp("captures") / "swatch"
    distances, rig = Distances(lamp_mm=600.0, field_mm=4.8), Rig(photodiode=False)
    plan = plan_grid("swatch", (0, 20, 40, 60, 80), 3, EXPOSURES, 2, distances, rig)
    folder.mkdir()
    write_plan(folder / "plan.json", plan)
    return Capture(folder, plan, folder / "plan.json", shoot(folder, plan))
