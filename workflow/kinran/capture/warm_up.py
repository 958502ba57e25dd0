"""Waiting for the lamp before the first exposure: it must be warm, and its light steady."""

from collections.abc import Callable

from kinran.rig.errors import RigError
from kinran.rig.goniometer import Goniometer, check_fault
from kinran.rig.protocol import Flag

WINDOW_S = 300.0
"""Seconds over which the drift is judged. The straight line through so long a time hardly sees the simulated lamp's
breathing of 0.2 % over 232 s, whose own slope is up to 0.32 %/min: with the breathing of 0.4 % over 1500 s it makes
0.11 %/min at worst. Over 120 s it would be 0.34 %/min, and block (tests/capture/test_warm_up.py)."""
STEADY_PER_MIN = 0.002
"""Relative drift per minute under which the lamp is steady: a choice, a fifteenth of `session.LAMP_LEAVES`; monitors
correct what is left."""
LOOK_S = 10.0
"""Seconds between two looks at the lamp: 30 in a window."""
LIMIT_S = 5400.0
"""Longest wait in seconds: three times a xenon lamp's warm-up of half an hour, a choice."""

Samples = list[tuple[float, float]]
"""Readings of the photodiode: seconds of the rig's clock, and counts."""


def drift_per_minute(samples: Samples) -> float | None:
    """Return the relative drift of the newest `WINDOW_S` seconds per minute; None if the readings span less time.

    It is the slope of the straight line of least squares, over the mean.
    """
    if not samples:
        return None
    newest = samples[-1][0]
    window = [(at - newest, counts) for at, counts in samples if at >= newest - WINDOW_S - LOOK_S / 2]
    middle = sum(at for at, _ in window) / len(window)
    mean = sum(counts for _, counts in window) / len(window)
    if window[0][0] > LOOK_S - WINDOW_S or len(window) < 3 or mean <= 0:
        return None
    slope = sum((at - middle) * counts for at, counts in window) / sum((at - middle) ** 2 for at, _ in window)
    return 60 * slope / mean


def warm_up(rig: Goniometer, samples: Samples, say: Callable[[float | None], None] = lambda drift: None) -> None:
    """Wait until the lamp is warm, and steady over the last minutes; a rig without a photodiode tells the first only.

    Parameters
    ----------
    rig
        The rig, its lamp lit.
    samples
        Earlier readings since the rig started, oldest first, such as those of the brackets just before; they are
        added to.
    say
        Function that hears of the drift at each look.

    Raises
    ------
    RigError
        The lamp does not become warm and steady in time, or the rig has a fault.
    """
    waited = 0.0
    while True:
        state = rig.status()
        check_fault(state)
        drift: float | None = 0.0
        if rig.identity.photodiode:
            counts = rig.intensity()
            samples.append((rig.state.uptime_ms / 1000, counts))
            drift = drift_per_minute(samples)
        if state.has(Flag.LAMP_WARM) and drift is not None and abs(drift) < STEADY_PER_MIN:
            return
        say(drift)
        if waited > LIMIT_S:
            why = "not warm" if not state.has(Flag.LAMP_WARM) else f"drifting by {abs(drift or 0.0):.1%} a minute"
            raise RigError(f"the lamp is still {why} after {LIMIT_S / 60:g} minutes; check it")
        rig.wait(LOOK_S)
        waited += LOOK_S
