"""Propose the directions that a fabric is shot from next: at first spread evenly, then where its fit is least sure."""

import logging
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.base.apart import spread
from kinran.base.files import InputError, atomic, read_json, write_json
from kinran.capture.directions import Directions, read_directions
from kinran.data.fabric import Fabric
from kinran.fit import design
from kinran.fit.lobed_regions import chosen_lobes
from kinran.fit.region_priors import Priors
from kinran.fit.samples import read_some, spread_over_regions

log = logging.getLogger(__name__)

Array = NDArray[np.float64]

LOWEST = 80.0
"""Largest θ in degrees: that of the paper's grid (Takeda2008, §4)."""
CANDIDATES = 1000
"""Directions to choose from, even in slopes: 0.047 apart there, 5° around the normal: a choice, the paper's step."""
JUDGED = 400
"""Directions over which the expected error is summed, even in solid angle. A choice."""
FIRST = 16
"""Directions of the first group, two shards: with fewer, no fit says anything. A choice."""
LEAST_JUDGES = 6
"""Fewest held-out lights by whose error a capture is done: of fewer, one that saw no highlight decides. A choice."""
GOLDEN = math.pi * (3 - math.sqrt(5))
"""Angle in radians between one point of a spiral and the next, which leaves no gaps [Vogel1979, §2]."""
PLASTIC = 1.32471795724474602596
"""Root of x³ = x + 1, whose powers lead to a sequence that is even wherever it ends."""
COLUMNS = ("theta", "phi", "group")


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads, once the sheet has a first group."""

    fabric: Annotated[Path | None, "folder of the fabric: radiance.zarr, labels.exr, regions.json"] = None
    prior: Annotated[Path | None, "priors of the regions (.json)"] = None
    evaluation: Annotated[Path | None, "errors on held-out lights (.json)"] = None
    choice: Annotated[Path | None, "lobes that `kinran choice` chose (.json), instead of --lobes and --tail"] = None


@dataclass(frozen=True)
class Options:
    """When to stop, and the lobes that are fitted."""

    error: Annotated[float, "relative error on held-out lights at which the capture is done"]
    most: Annotated[int, "most directions"]
    holdout: Annotated[int, "one light of so many is held out"] = 8
    lobes: Annotated[Literal[1, 2], "number of lobes of the slope model"] = 1
    tail: Annotated[Literal["gaussian", "ggx"], "tail of its lobes"] = "ggx"


@dataclass(frozen=True)
class Round:
    """What is known after a group.

    Attributes
    ----------
    directions
        Number of rows of the sheet.
    held_out
        Number of lights that were held out.
    error, deviation
        Relative error under these, and the standard error of the mean of the errors of single lights.
    expected
        Relative error that the next group is expected to lead to, by that of now; None where there is none.
    """

    directions: int
    held_out: int
    error: float
    deviation: float
    expected: float | None = None


def main(
    inputs: Inputs,
    out: Annotated[Path, "OUT", "sheet of the directions (.tsv), which gets a group; beside it, its rounds (.json)"],
    options: Options,
) -> None:
    """Begin a sheet, append a group to it, or leave it as it is where the error is low enough or there are enough.

    Held-out lights are no candidates: they follow from their number in the sheet alone.

    Raises
    ------
    InputError
        An option is out of range, a file is missing, or the results are not those of the sheet's directions.
    """
    if not options.error > 0 or options.holdout < 2 or options.most < FIRST:
        raise InputError(
            f"--error {options.error:g} --most {options.most} --holdout {options.holdout}: give an error over 0, at"
            f" least {FIRST} directions, and a holdout of 2 or more"
        )
    if not out.exists():
        count = FIRST - len(_held(0, FIRST, options.holdout))
        even = spread(candidates(), count + 1)[1:]  # the first is the normal, which the monitors see
        _append(out, [], rows_of(candidates()[even], 0, FIRST, options.holdout))
        print(f"{out}: begins with {FIRST} directions, spread evenly")
        return
    if inputs.fabric is None or inputs.prior is None or inputs.evaluation is None:
        raise InputError(f"{out}: is begun; give --fabric, --prior and --evaluation for its next group")
    sheet, fabric = read_directions(out), Fabric(inputs.fabric)
    _check_same(out, sheet, fabric)
    now = judged(inputs.evaluation, len(_listed(sheet)))
    said = f"{now.directions} directions: error {now.error:.3f} ± {now.deviation:.3f} on {now.held_out} lights held out"
    count = min(design.batch(now.directions), options.most - now.directions) // design.GROUP * design.GROUP
    if now.error <= options.error and now.held_out >= LEAST_JUDGES:
        print(f"{out}: done; {said}, at most {options.error:g} was wanted")
    elif count <= 0:
        print(f"{out}: stops, since --most is {options.most}; {said}, {options.error:g} was wanted")
    else:
        found, gain = chosen(fabric, inputs, options, count)
        now = replace(now, expected=round(now.error * gain, 5))
        _append(out, _listed(sheet), rows_of(found, now.directions, count, options.holdout))
        print(f"{out}: {said}; adds {count}, after which {now.expected:.3f} is expected")
    _keep(out.with_suffix(".json"), now)


def chosen(fabric: Fabric, inputs: Inputs, options: Options, count: int) -> tuple[Array, float]:
    """Directions (n, 3) of the group's lights for the fit, and the factor by which the error is expected to fall."""
    assert inputs.prior
    regions = len(fabric.regions)
    texels = spread_over_regions(fabric.labels, regions, -(-design.TEXELS // regions), fabric.stack.inside)
    samples = read_some(fabric, texels)
    sizes = np.array([region.texels for region in fabric.regions], float)
    share = (sizes / np.maximum(np.bincount(samples.region, minlength=regions), 1))[samples.region]
    lobes = chosen_lobes(inputs.choice, options.tail, options.lobes)
    free = candidates()
    near = np.linalg.norm(frames.slopes(free)[:, None] - frames.slopes(fabric.stack.directions), axis=2).min(1)
    free = free[near > 1e-3]
    taken = len(fabric.stack.directions) - 1  # the last is the normal
    wanted = count - len(_held(taken, count, options.holdout))
    priors = Priors.read(inputs.prior, fabric)
    found = design.propose(samples, lobes, priors, free, _even_in_solid_angle(JUDGED), wanted, share)
    return free[found.chosen], math.sqrt(found.expected[-1] / found.expected[0])


def candidates() -> Array:
    """Directions (n, 3) that are even in slopes of the half vector, the normal first."""
    k = np.arange(CANDIDATES)
    radius = math.tan(math.radians(LOWEST) / 2) * np.sqrt(k / (CANDIDATES - 1))
    return frames.direction(2 * np.arctan(radius), GOLDEN * k)


def _even_in_solid_angle(count: int) -> Array:
    k = np.arange(count) + 0.5
    return frames.direction(np.arccos(1 - (1 - math.cos(math.radians(LOWEST))) * k / count), GOLDEN * k)


def judge(number: int) -> Array:
    """Direction (3,) of the held-out light of this number, from 0: even in solid angle, however many there are."""
    u, v = (0.5 + (number + 1) * PLASTIC**-k for k in (1, 2))
    theta = math.acos(1 - (1 - math.cos(math.radians(LOWEST))) * (u % 1))
    return frames.direction(theta, 2 * math.pi * (v % 1))


def _held(taken: int, count: int, every: int) -> list[int]:
    """Places in a group after so many directions whose lights are held out (`kinran.data.hold_out_rule`)."""
    return [k for k in range(count) if (taken + k) % every == every // 2]


def rows_of(lights: Array, taken: int, count: int, every: int) -> list[tuple[float, float]]:
    """Rows (θ, φ) in degrees of a group after so many: lights for the fit (n, 3), and held-out ones between."""
    held, rest = _held(taken, count, every), iter(lights)
    vectors = [judge((taken + k) // every) if k in held else next(rest) for k in range(count)]
    theta, phi = np.degrees(frames.angles(np.array(vectors))).round(2)
    return list(zip(theta.tolist(), (phi % 360).tolist(), strict=True))


def _listed(sheet: Directions) -> list[tuple[float, float, int]]:
    return [(each.theta, each.phi, int(name)) for name, own in sheet.groups.items() for each in own]


def _append(out: Path, listed: list[tuple[float, float, int]], rows: list[tuple[float, float]]) -> None:
    """Write the sheet with a further group, whole or not at all."""
    group = listed[-1][2] + 1 if listed else 0
    lines = [f"{theta:g}\t{phi:g}\t{of}" for theta, phi, of in [*listed, *((t, p, group) for t, p in rows)]]
    with atomic(out) as temporary:
        temporary.write_text("\n".join(["\t".join(COLUMNS), *lines]) + "\n", encoding="utf-8")


def _check_same(out: Path, sheet: Directions, fabric: Fabric) -> None:
    """Check that the stack has been taken under the directions of the sheet, and no others."""
    listed = _listed(sheet)
    wanted = frames.direction(*np.radians([row[:2] for row in listed]).T)
    seen = fabric.stack.directions[:-1]  # the last light is the normal, which no row has
    if seen.shape != wanted.shape or np.abs(seen - wanted).max() > 1e-4:
        raise InputError(
            f"{out}: has {len(listed)} directions, and {fabric.stack_path} was taken under {len(seen)}, or others;"
            " run the workflow before the next group is chosen"
        )


def judged(evaluation: Path, directions: int) -> Round:
    """Error of the default material on the held-out lights, and how far it varies from light to light.

    Raises
    ------
    InputError
        The file is missing, or no light was held out.
    """
    value = read_json(evaluation)
    try:
        of: dict[str, Any] = value["methods"][value["default"]]
        error, lights = float(of["relative_error"]), [float(x["relative_error"]) for x in of["lights"].values()]
    except (KeyError, TypeError) as problem:
        raise InputError(f"{evaluation}: has no errors under held-out lights ({problem!r}); set holdout") from None
    deviation = float(np.std(lights) / math.sqrt(len(lights)))
    return Round(directions, len(lights), error, round(deviation, 5))


def _keep(path: Path, now: Round) -> None:
    """Put a round among those of the sheet, in the place of an earlier one of as many directions."""
    rounds = [r for r in (read_json(path) if path.exists() else []) if r["directions"] < now.directions]
    write_json(path, [*rounds, asdict(now)])
