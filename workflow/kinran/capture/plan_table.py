"""The table of a plan: directions, shots, frames, travel, time, dose and disk of each group and of the whole."""

from collections.abc import Sequence
from pathlib import Path

from kinran.capture.arms import pose_of, shots_time
from kinran.capture.assembly import LIT, Rig, bracket_time, shot_time
from kinran.capture.order import spanning_time, travel_time
from kinran.data.capture_plan import Plan, Shot
from kinran.rig.motion import mdeg

FRAME_BYTES = 20_000_000
"""Bytes of a frame: 3906 × 2602 pixels of the paper's camera in 16 bits are 20.3 MB."""


def frame_bytes(folder: Path) -> int:
    """Return the bytes of the largest frame of the capture in a folder; `FRAME_BYTES` where it has none yet."""
    frames = (path.stat().st_size for path in (folder / "frames").glob("*/*") if path.is_file())
    return max(frames, default=FRAME_BYTES)


def plan_table(plan: Plan, rig: Rig, each: int = FRAME_BYTES, lux: float | None = None) -> str:
    """Return the table of a plan on a rig.

    The way to a group counts for the group. Its time holds moves, rests and brackets, and neither homing, warm-up nor a
    person's changes of subject.

    Parameters
    ----------
    plan
        The plan.
    rig
        Rig that shoots it.
    each
        Bytes of a frame.
    lux
        Illuminance on the fabric under the open shutter in lux, for the dose in lux hours; None when unknown.
    """
    backlash = mdeg(rig.backlash)
    rows = [["group", "directions", "shots", "frames", "travel min", "time min", "light s", "lux h", "GB"]]
    before: list[Shot] = []
    for group in plan.groups:
        travel = shots_time([*before, *group.shots], rig.axes, backlash)
        rows.append(_row(plan, group.name, len(group.lights), group.shots, travel, each, lux))
        before = [group.shots[-1]]
    every = [shot for group in plan.groups for shot in group.shots]
    rows.append(_row(plan, "all", len(plan.lights), every, shots_time(every, rig.axes, backlash), each, lux))
    kept = [k for k, name in enumerate(rows[0]) if lux is not None or name != "lux h"]
    widths = [max(len(row[k]) for row in rows) for k in kept]
    lines = ["  ".join(row[k].rjust(width) for k, width in zip(kept, widths, strict=True)) for row in rows]
    return "\n".join([*lines, compared(plan, rig)])


def compared(plan: Plan, rig: Rig) -> str:
    """Return a sentence that compares the moves between lights and monitors with the bound of all orders."""
    poses = [pose_of(shot) for group in plan.groups if group.lights for shot in group.shots]
    travel, bound = travel_time(poses, rig.axes, mdeg(rig.backlash)), spanning_time(poses, rig.axes)
    return (
        f"moves between lights and monitors: {travel / 60:.1f} min, {travel / max(bound, 1e-9):.2f} times the"
        f" minimum spanning tree of their poses ({bound / 60:.1f} min), which no order of them undercuts"
    )


def _row(
    plan: Plan, name: str, lights: int, shots: Sequence[Shot], travel: float, each: int, lux: float | None
) -> list[str]:
    frames = len(shots) * len(plan.exposures_s)
    lit = bracket_time(plan.exposures_s) * sum(shot.kind in LIT for shot in shots)
    return [
        name,
        str(lights),
        str(len(shots)),
        str(frames),
        f"{travel / 60:.1f}",
        f"{(travel + len(shots) * shot_time(plan.exposures_s)) / 60:.1f}",
        f"{lit:.0f}",
        f"{lit * (lux or 0) / 3600:.4g}",
        f"{frames * each / 1e9:.2f}",
    ]
