"""Travel of plans against the spanning tree of their poses, for grids, lists and resumes, on axes of several speeds."""

import argparse
import itertools
import math
import random
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from kinran.base.files import write_json
from kinran.capture.arms import Pose, pose_of
from kinran.capture.assembly import Rig
from kinran.capture.directions import Direction, Directions, plan_directions
from kinran.capture.grid import plan_grid
from kinran.capture.order import reorder, spanning_time, travel_time
from kinran.data.capture_plan import Plan
from kinran.rig.motion import AXES, Four, mdeg, with_motion

PAPER = tuple(range(0, 81, 5))
GRIDS = (("paper", PAPER, 72), ("24 meridians", PAPER, 24), ("coarse", (0, 20, 40, 60, 80), 8))
SPEEDS = ((10.0, 30.0), (10.0, 10.0), (30.0, 10.0), (5.0, 20.0))
"""Top speeds of θ and φ in deg/s, reached in half a second."""
LISTS = (20, 64, 200, 400)
"""Directions of the random lists, evenly over the hemisphere to 80°."""
MISSING = (20, 60, 150, 400)
"""Shots of the paper's grid that a resume lacks."""
HIGHEST = 80.0
"""Largest θ of the random lists in degrees."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Measure, print a table, write JSON."""
    rows = []
    for speeds, (name, thetas, phis) in itertools.product(SPEEDS, GRIDS):
        axes = moving(*speeds)
        naive = [(mdeg(t), mdeg(360 * p / phis)) for t in thetas for p in range(phis)]
        began = time.process_time()
        plan = plan_grid("x", thetas, phis, (0.04,), rig=Rig(axes))
        rows.append(row(f"{name}, {speeds[0]:g} and {speeds[1]:g}°/s", plan, naive, axes, time.process_time() - began))
    for count, turned in itertools.product(LISTS, (False, True)):
        listed = sorted(scattered(count), key=lambda each: each.phi) if turned else scattered(count)
        poses = [(mdeg(each.theta), mdeg(each.phi)) for each in listed]
        groups = {f"{k:02d}": listed[64 * k : 64 * k + 64] for k in range(math.ceil(count / 64))}
        began = time.process_time()
        plan = plan_directions("x", Directions(groups, []), (0.04,))
        rows.append(
            row(f"random {count}{', sorted by φ' if turned else ''}", plan, poses, AXES, time.process_time() - began)
        )
    rows += resumes()
    columns = ["what", "travel_min", "given_min", "bound_min", "ratio", "of_given", "of_groups", "seconds"]
    print("  ".join(f"{name:>10}" if k else f"{name:28}" for k, name in enumerate(columns)))
    for each in rows:
        cells = (f"{each[name]:10.2f}" if name in each else " " * 10 for name in columns[1:])
        print(f"{each['what']:28}  " + "  ".join(cells))
    if args.out:
        write_json(args.out, rows)


def moving(theta: float, phi: float) -> Four:
    """Return the rig's axes with these speeds in deg/s."""
    return with_motion(AXES, (theta, phi), (2 * theta, 2 * phi))


def row(what: str, plan: Plan, given: Sequence[Pose], axes: Four, seconds: float) -> dict[str, Any]:
    """Return the travel of a plan through all its lights and monitors, and what it is compared with.

    ``bound_min`` and ``ratio``: the spanning tree of the plan's own poses; ``of_given``: against that of the poses in
    the order in which they are given, θ = 0 on each meridian; ``of_groups``: against the trees of the groups and the
    moves between these, which no order undercuts that keeps the groups.
    """
    groups = [[pose_of(shot) for shot in group.shots] for group in plan.groups if group.lights]
    way = list(itertools.chain(*groups))
    travel, bound = travel_time(way, axes), spanning_time(way, axes)
    links = sum(travel_time([a[-1], b[0]], axes) for a, b in itertools.pairwise(groups))
    return {
        "what": what,
        "travel_min": travel / 60,
        "given_min": travel_time(given, axes) / 60,
        "bound_min": bound / 60,
        "ratio": travel / bound,
        "of_given": travel / spanning_time(given, axes),
        "of_groups": travel / (links + sum(spanning_time(group, axes) for group in groups)),
        "seconds": seconds,
    }


def resumes() -> list[dict[str, Any]]:
    """Return the travel to what is missing of the paper's grid, in a new order and in the order of the plan."""
    shots = [shot for group in plan_grid("x", PAPER, 72, (0.04,)).groups if group.lights for shot in group.shots]
    found = []
    for count in MISSING:
        missing = [shots[k] for k in sorted(random.Random(count).sample(range(len(shots)), count))]
        began = time.process_time()
        order = reorder((0, 0, 0, 0), missing)
        seconds = time.process_time() - began
        ways = [[(0, 0), *map(pose_of, each)] for each in (order, missing)]
        travel, given, bound = travel_time(ways[0]), travel_time(ways[1]), spanning_time(ways[0])
        what = {"what": f"resume, {count} missing", "travel_min": travel / 60, "given_min": given / 60}
        found.append({**what, "bound_min": bound / 60, "ratio": travel / bound, "seconds": seconds})
    return found


def scattered(count: int) -> list[Direction]:
    """Return random directions, as dense everywhere on the hemisphere to `HIGHEST`."""
    r, low = random.Random(count), math.cos(math.radians(HIGHEST))
    return [Direction(math.degrees(math.acos(r.uniform(low, 1))), r.uniform(0, 360)) for _ in range(count)]
