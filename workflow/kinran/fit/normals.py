"""Find the surface normals of a stack by Lambert's law, with the least absolute residuals."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np

from kinran.base.exr import write_exr
from kinran.data.fabric import Fabric
from kinran.fit import lambert_normals
from kinran.fit.samples import read_samples


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]


def main(inputs: Inputs, out: Annotated[Path, "OUT", "normals (.exr): x, y, z"]) -> None:
    """Write the normals of all texels, from the training lights."""
    fabric = Fabric(inputs.fabric)
    found = np.zeros((fabric.stack.height, fabric.stack.width, 3), np.float32)
    for box in fabric.stack.tiles():
        y0, y1, x0, x1 = box
        found[y0:y1, x0:x1] = lambert_normals.normals(read_samples(fabric, box)).reshape(y1 - y0, x1 - x0, 3)
    write_exr(out, {name: np.ascontiguousarray(found[..., k]) for k, name in enumerate("xyz")})
