"""Plan a capture: a grid or a list of directions in groups, with their order; show its travel, time, dose and disk."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.distances import Distances
from kinran.base.drawing.canvas import write
from kinran.base.files import InputError
from kinran.capture.assembly import Rig
from kinran.capture.directions import plan_directions, read_directions
from kinran.capture.grid import plan_grid
from kinran.capture.plan_drawing import draw_plan
from kinran.capture.plan_table import frame_bytes, plan_table
from kinran.data.capture_plan import write_plan
from kinran.rig.motion import AXES, with_motion


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


def four(text: str) -> tuple[float, ...]:
    """Parse a value over 0 for each axis, such as ``10,30,10,30``.

    Raises
    ------
    InputError
        The text has not four numbers over 0.
    """
    values = numbers(text)
    if len(values) != len(AXES) or not all(0 < value < float("inf") for value in values):
        raise InputError(f"'{text}': give four numbers over 0, of light θ, light φ, camera θ and camera φ")
    return values


@dataclass(frozen=True)
class Outputs:
    plan: Annotated[Path, "OUT", "plan.json"]
    draw: Annotated[Path | None, "--draw FILE", "drawing of the directions and the way through them (.svg or .png)"] = (
        None
    )


@dataclass(frozen=True)
class Options:
    fabric: Annotated[str, "name of the fabric"]
    exposures: Annotated[Sequence[float], "--exposures 0.04,0.01,…", "shutter times in seconds", numbers]
    thetas: Annotated[Sequence[float], "--thetas 0,5,10,…", "polar angles of a grid in degrees", numbers] = ()
    phis: Annotated[int, "number of meridians of a grid"] = 0
    meridians: Annotated[int, "meridians in a group of a grid"] = 4
    directions: Annotated[
        Path | None,
        "--directions FILE",
        "instead of a grid, a sheet with the columns theta and phi, and perhaps camera_theta, camera_phi and group",
    ] = None
    lamp_mm: Annotated[float | None, "distance of the lamp"] = None
    field_mm: Annotated[float | None, "width of the field"] = None
    camera_mm: Annotated[float | None, "distance of the camera's centre of projection"] = None
    backlash: Annotated[float, "degrees by which an axis goes beyond a target that it would reach from below"] = 0.0
    speeds: Annotated[Sequence[float], "--speeds A,B,C,D", "top speeds of the four axes in deg/s", four] = ()
    accelerations: Annotated[Sequence[float], "--accelerations A,B,C,D", "their accelerations in deg/s²", four] = ()
    photodiode: Annotated[bool, "whether the rig measures its lamp; if not, monitors are spread over each group"] = True
    lux: Annotated[float | None, "illuminance on the fabric under the open shutter, for the dose in lux hours"] = None
    frame_mb: Annotated[
        float | None, "megabytes of a frame, for the room on the disk (default: the largest beside the plan, or 20)"
    ] = None


def main(out: Outputs, options: Options) -> None:
    """Write the plan, print its table, and draw it where that is asked for."""
    o = options
    if out.draw and out.draw.suffix not in (".svg", ".png"):
        raise InputError(f"{out.draw}: is neither .svg nor .png; give one of them")
    distances = Distances(o.lamp_mm, o.field_mm, o.camera_mm)
    rig = Rig(with_motion(AXES, o.speeds, o.accelerations), o.backlash, o.photodiode)
    if o.directions is not None:
        if o.thetas or o.phis:
            raise InputError(f"{o.directions}: takes the place of --thetas and --phis; leave them out")
        plan = plan_directions(o.fabric, read_directions(o.directions), o.exposures, distances, rig)
    else:
        plan = plan_grid(o.fabric, o.thetas, o.phis, o.exposures, o.meridians, distances, rig)
    write_plan(out.plan, plan)
    if out.draw:
        write(out.draw, draw_plan(plan))
    size = frame_bytes(out.plan.parent) if o.frame_mb is None else round(1e6 * o.frame_mb)
    print(plan_table(plan, rig, size, o.lux))
