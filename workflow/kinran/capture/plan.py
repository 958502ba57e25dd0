"""Plan a capture: a grid of directions in groups, their order, duration and light dose."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.distances import Distances
from kinran.base.files import InputError
from kinran.capture.grid import plan_grid
from kinran.data.capture_plan import write_plan


def numbers(text: str) -> tuple[float, ...]:
    """Parse numbers such as ``0,5,10``.

    Raises
    ------
    InputError
        A part is not a number.
    """
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        raise InputError(f"'{text}': is not a list of numbers; give them as 0,5,10") from None


@dataclass(frozen=True)
class Options:
    fabric: Annotated[str, "name of the fabric"]
    thetas: Annotated[Sequence[float], "--thetas 0,5,10,…", "polar angles in degrees", numbers]
    phis: Annotated[int, "number of meridians"]
    exposures: Annotated[Sequence[float], "--exposures 0.04,0.01,…", "shutter times in seconds", numbers]
    meridians: Annotated[int, "meridians in a group"] = 4
    lamp_mm: Annotated[float | None, "distance of the lamp"] = None
    field_mm: Annotated[float | None, "width of the field"] = None
    camera_mm: Annotated[float | None, "distance of the camera's centre of projection"] = None


def main(out: Annotated[Path, "OUT", "plan.json"], options: Options) -> None:
    """Write the plan."""
    o = options
    distances = Distances(o.lamp_mm, o.field_mm, o.camera_mm)
    write_plan(out, plan_grid(o.fabric, o.thetas, o.phis, o.exposures, o.meridians, distances))
