"""The light that a sample has had: time under the open shutter, and its dose in lux seconds where the lux are known.

Heritage textiles fade by the dose. Illuminance is taken as that of light from straight above, so that the dose is never
understated.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from kinran.base.files import InputError
from kinran.capture.journal import Record

FRAME_S = 1.0
"""Seconds under the open shutter that a frame takes besides its exposure, in a prediction (`assembly.CAMERA_S`)."""
LEFT_OPEN_S = 2.0
"""Seconds after which the watchdog closes the shutter of a host that died (docs/rig.md, Rules)."""


@dataclass(frozen=True)
class Lighting:
    """What the config says of the light on the sample.

    Attributes
    ----------
    lux
        Illuminance on the sample under the open shutter; None if it was not measured.
    limit_lux_h
        Dose in lux hours that the sample must not exceed; None for no limit.
    """

    lux: float | None = None
    limit_lux_h: float | None = None


@dataclass(frozen=True)
class Dose:
    """Light on a sample: seconds under the open shutter, and lux seconds of those for which the lux are known."""

    open_s: float = 0.0
    lux_s: float = 0.0

    def __add__(self, other: "Dose") -> "Dose":
        return Dose(self.open_s + other.open_s, self.lux_s + other.lux_s)

    def __str__(self) -> str:
        shown = f"{self.open_s / 60:.1f} min under the lamp"
        return f"{shown}, {self.lux_h:.3g} lux hours" if self.lux_s else shown

    @property
    def lux_h(self) -> float:
        """Dose in lux hours."""
        return self.lux_s / 3600


def light_dose(records: Iterable[Record]) -> Dose:
    """Return the light that the sample of a journal has had, with repeats and brackets that were thrown away.

    A bracket whose session was killed has no record of its light: it counts as if it had been taken to its end.
    """
    estimated: dict[int, Dose] = {}
    measured: dict[int, list[Dose]] = {}
    lux, brackets = 0.0, 0
    for record in records:
        if record["t"] == "session":
            lux = float(record.get("lux") or 0.0)
        elif record["t"] == "intent":
            if record.get("subject", "fabric") == "fabric":
                cut = of_bracket(record["exposures"], lux) + Dose(LEFT_OPEN_S, LEFT_OPEN_S * lux)
                estimated[brackets], measured[brackets] = cut, []
            brackets += 1
        elif record["t"] == "dose" and record["intent"] in measured:
            measured[record["intent"]].append(Dose(record["open_s"], record["lux_s"]))
    return sum((sum(each, Dose()) if each else estimated[k] for k, each in measured.items()), Dose())


def of_bracket(exposures: Sequence[float], lux: float) -> Dose:
    """Return the light that a bracket is going to take."""
    seconds = sum(exposures) + FRAME_S * len(exposures)
    return Dose(seconds, seconds * lux)


def check_dose(so_far: Dose, exposures: Sequence[float], lighting: Lighting) -> None:
    """Check that a bracket may be taken.

    Raises
    ------
    InputError
        The sample would get more light than the limit.
    """
    if lighting.limit_lux_h is None:
        return
    then = so_far + of_bracket(exposures, lighting.lux or 0.0)
    if then.lux_h > lighting.limit_lux_h:
        raise InputError(
            f"rig.dose_limit_lux_h: the sample has had {so_far.lux_h:.3g} lux hours, and one bracket more makes"
            f" {then.lux_h:.3g} of at most {lighting.limit_lux_h:g}; what is shot is safe: end here, or raise the limit"
        )
