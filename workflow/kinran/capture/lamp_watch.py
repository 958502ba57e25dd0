"""The lamp in a session: warm and steady before the first exposure, and at the same level until the last."""

import logging
from collections.abc import Callable

from kinran.capture.journal import Journal, Record
from kinran.rig.errors import RigError
from kinran.rig.goniometer import Goniometer, check_fault
from kinran.rig.protocol import Flag

WINDOW_S = 300.0
"""Seconds over which the drift is judged. The straight line through so long a time hardly sees the simulated lamp's
breathing of 0.2 % over 232 s, whose own slope is up to 0.32 %/min: with the breathing of 0.4 % over 1500 s it makes
0.11 %/min at worst. Over 120 s it would be 0.34 %/min, and block (tests/capture/test_lamp_watch.py)."""
STEADY_PER_MIN = 0.002
"""Relative drift per minute under which the lamp is steady: a choice, a fifteenth of `LAMP_LEAVES`; monitors
correct what is left."""
LOOK_S = 10.0
"""Seconds between two looks at the lamp: 30 in a window."""
FRESH_S = 1800.0
"""Seconds for which a lamp that was found steady, and burns on, counts as steady: a choice, its warm-up's time."""
LIMIT_S = 5400.0
"""Longest wait in seconds: three times a xenon lamp's warm-up of half an hour, a choice."""

LAMP_LEAVES, LAMP_RETURNS = 0.03, 0.02
"""Relative drift of the lamp at which shooting pauses, and at which it goes on: several times the simulated lamp's
breathing of 0.6 %. Monitors correct smaller drifts. No measurement of a real lamp stands behind these numbers."""
LAMP_WAIT_S = 600.0
"""Longest pause for the lamp in seconds: a choice; a lamp that has drifted for ten minutes needs a person."""

log = logging.getLogger(__name__)

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


def warm_up(
    rig: Goniometer,
    samples: Samples,
    steady: bool = False,
    say: Callable[[float | None], None] = lambda drift: None,
) -> None:
    """Wait until the lamp is warm, and steady over the last minutes; a rig without a photodiode tells the first only.

    Parameters
    ----------
    rig
        The rig, its lamp lit.
    samples
        Earlier readings since the rig started, oldest first, such as those of the brackets just before; they are
        added to.
    steady
        Whether a session has just found the lamp steady: then readings that span too little time are not waited for.
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
        warm = state.has(Flag.LAMP_WARM)
        drift: float | None = 0.0
        if rig.identity.photodiode:
            counts = rig.intensity()
            samples.append((rig.state.uptime_ms / 1000, counts))
            drift = drift_per_minute(samples)
        steady = steady and warm
        if warm and (steady if drift is None else abs(drift) < STEADY_PER_MIN):
            return
        say(drift)
        if waited > LIMIT_S:
            why = "not warm" if not warm else f"drifting by {abs(drift or 0.0):.1%} a minute"
            raise RigError(f"the lamp is still {why} after {LIMIT_S / 60:g} minutes; check it")
        rig.wait(LOOK_S)
        waited += LOOK_S


class LampWatch:
    """The lamp of a rig in one session; a rig without a photodiode is trusted.

    Parameters
    ----------
    rig
        The rig.
    journal
        Journal of the capture, whose readings since the rig started count.

    Attributes
    ----------
    reference
        Reading of the photodiode before the first exposure of the session.
    """

    def __init__(self, rig: Goniometer, journal: Journal) -> None:
        self.rig, self.journal = rig, journal
        self.reference = 0

    def prepare(self, tell: Callable[..., None]) -> None:
        """Light the lamp and wait for it (`warm_up`); `tell` hears of its state (`kinran.capture.live.Live`).

        Raises
        ------
        RigError
            The lamp does not become warm and steady in time, or the rig has a fault.
        """
        self.rig.lamp(True)
        now = self.rig.status().uptime_ms / 1000
        readings = [(record["time"], record["photodiode"]) for record in self._recent(now, 2 * WINDOW_S)]
        warm_up(
            self.rig,
            readings,
            any(record["t"] == "steady" for record in self._recent(now, FRESH_S)),
            lambda drift: tell(phase="waits for the lamp", lamp=_in_words(drift)),
        )
        tell(lamp="warm and steady")
        self.reference = self.reading()
        self.journal.append(
            {"t": "steady", "boot": self.rig.identity.boot, "time": round(self.rig.state.uptime_ms / 1000, 3),
             "photodiode": self.reference}
        )  # fmt: skip

    def reading(self) -> int:
        """Return the light of the lamp in counts; 0 where the rig does not measure it."""
        return self.rig.intensity() if self.rig.identity.photodiode else 0

    def steady(self, kind: str, reading: int) -> bool:
        """Return whether the lamp is at its level of the start of the session; a dark shot does not need it."""
        if kind == "dark" or not self.rig.identity.photodiode:
            return True
        return abs(reading - self.reference) <= LAMP_LEAVES * self.reference

    def wait(self) -> None:
        """Pause until the lamp is back at its level of the start of the session.

        Raises
        ------
        RigError
            The lamp does not come back in `LAMP_WAIT_S`.
        """
        self.journal.append({"t": "pause", "reason": "lamp", "photodiode": self.rig.state.photodiode})
        log.info("capture: the lamp drifted; waiting for it")
        for _ in range(int(LAMP_WAIT_S / 10)):
            self.rig.wait(10.0)
            if abs(self.rig.intensity() - self.reference) <= LAMP_RETURNS * self.reference:
                return
        raise RigError(
            f"the lamp stays more than {LAMP_RETURNS:.0%} off its level for {LAMP_WAIT_S / 60:g} minutes;"
            " check it, then run the capture again"
        )

    def _recent(self, now: float, seconds: float) -> list[Record]:
        """Return the records with a reading of the lamp of the last `seconds` since the rig started."""
        boot = self.rig.identity.boot
        read = [record for record in self.journal.records if record["t"] in ("intent", "steady")]
        return [record for record in read if record["boot"] == boot and now - seconds < record["time"] <= now]


def _in_words(drift: float | None) -> str:
    return "warms up" if drift is None else f"drifts by {drift:+.2%} a minute"
