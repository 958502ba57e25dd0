"""Chart accuracy against speed: methods of one kind on the held-out lights of one fabric.

All methods, the baselines too, see training lights alone. Of maps larger than 128 × 128 texels the middle is
taken. docs/chart.md explains each column.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from kinran.base.files import InputError, check_name
from kinran.compare import default, experiments, rows, trial
from kinran.compare.methods import kinds, of
from kinran.data.fabric import Fabric


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    material: Annotated[Path | None, "material of the pipeline (.exr), for the kind default"] = None
    summary: Annotated[Path | None, "cost of that material (.json)"] = None


@dataclass(frozen=True)
class Options:
    """Kind of the methods, and name of the fabric in the rows."""

    name: Annotated[str, "name of the fabric"]
    kind: Annotated[str, "kind of the methods: a file of kinran/compare/methods, or default"]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "table (.csv)"], options: Options) -> None:
    """Write the table of a kind of method.

    Raises
    ------
    InputError
        The kind is unknown, the fabric has no held-out light, or a file of the default is missing.
    """
    name = check_name(options.name, "fabric")
    fabric = Fabric(inputs.fabric)
    if options.kind in kinds():
        found = experiments.run(trial.read(fabric), name, of(options.kind))
    elif options.kind != default.FAMILY:
        raise InputError(f"--kind {options.kind}: is none of {', '.join([*kinds(), default.FAMILY])}")
    elif inputs.material and inputs.summary:
        found = default.run(trial.read(fabric), name, fabric, inputs.material, inputs.summary)
    else:
        raise InputError(f"{out}: the default needs --material and --summary; give both")
    rows.write(out, found)
