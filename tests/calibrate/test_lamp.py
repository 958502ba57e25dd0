"""The light of the lamp at each shot."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from kinran.bracket.shots import Taken
from kinran.calibrate.lamp import lamp_gains

WITHOUT_PHOTODIODE: Any = SimpleNamespace(monitor=10.0, photodiode=0)


def taken(name: str, time_s: float, session: int) -> Taken:
    return Taken(name, "monitor" if name.startswith("m") else "light", 0, time_s, None, (), session)


def test_times_of_two_sessions_are_no_times_of_one() -> None:
    """The rig was switched off in between, and its clock began anew: each shot has the lamp of its own session."""
    shots = [
        taken("m1", 100.0, 0), taken("l1", 150.0, 0), taken("m2", 200.0, 0),
        taken("m3", 90.0, 1), taken("l2", 160.0, 1), taken("m4", 190.0, 1), taken("l3", 20.0, 2),
    ]  # fmt: skip
    levels = {"m1": 10.0, "m2": 11.0, "m3": 8.0, "m4": 9.0}
    gains = lamp_gains(shots, WITHOUT_PHOTODIODE, levels, Path("00.json"))
    assert list(gains) == [shot.shot for shot in shots]
    assert gains["l1"] == pytest.approx(1.05)
    assert gains["l2"] == pytest.approx(0.8 + 0.1 * 0.7)
    assert gains["l3"] == pytest.approx(0.95)
