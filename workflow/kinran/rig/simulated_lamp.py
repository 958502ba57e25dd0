"""The light of the simulated xenon lamp: it warms up, breathes and ages."""

import math

WARM_UP_S = 1800.0
"""Seconds after which the lamp counts as warm: half an hour, as for a real xenon lamp."""
PHOTODIODE = 100_000
"""Counts of the photodiode at the lamp's nominal light, so that a count is 10⁻⁵ of it."""


def lamp_output(seconds: float) -> float:
    """Return the relative light of the simulated xenon lamp, `seconds` after it was lit; near 1 once warm.

    Its warm-up, breathing and ageing are made up.
    """
    warming = -0.15 * math.exp(-seconds / 300)
    breathing = 0.004 * math.sin(2 * math.pi * seconds / 1500) + 0.002 * math.sin(seconds / 37)
    ageing = -0.01 * seconds / 36_000
    return 1 + warming + breathing + ageing
