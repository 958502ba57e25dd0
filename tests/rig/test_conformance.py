"""One table of scenarios, and every implementation of the rig's side of the protocol."""

import pytest
from rig_conformance import PythonDevice, run
from rig_scenarios import SCENARIOS, Scenario

BY_NAME = pytest.mark.parametrize("scenario", SCENARIOS, ids=lambda scenario: scenario.name)


@BY_NAME
def test_the_simulated_firmware(scenario: Scenario) -> None:
    run(scenario, PythonDevice())


def test_the_table_is_a_table() -> None:
    assert len({scenario.name for scenario in SCENARIOS}) == len(SCENARIOS) >= 45
