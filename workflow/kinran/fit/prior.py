"""Learn the prior of each region on the shapes of its lobes, from fits of a sample of its texels."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from kinran.data.fabric import Fabric
from kinran.fit import learned_priors, under_priors
from kinran.fit.lobed_regions import chosen_lobes
from kinran.fit.samples import read_some, spread_over_regions, training_lights

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    choice: Annotated[Path | None, "lobes that `kinran choice` chose (.json), instead of --lobes and --tail"] = None


@dataclass(frozen=True)
class Options:
    """Lobes that the priors are for."""

    lobes: Annotated[Literal[1, 2], "number of lobes of the slope model"] = 1
    tail: Annotated[Literal["gaussian", "ggx"], "tail of its lobes"] = "ggx"
    threads: Annotated[int, "threads of this machine"] = 1


def main(inputs: Inputs, out: Annotated[Path, "OUT", "priors (.json)"], options: Options = Options()) -> None:
    """Fit a sample of each region, and write the priors, the factors of lights, and whether to fit robustly."""
    fabric = Fabric(inputs.fabric)
    lobes = chosen_lobes(inputs.choice, options.tail, options.lobes)
    regions = len(fabric.regions)
    samples = read_some(fabric, spread_over_regions(fabric.labels, regions, learned_priors.SAMPLE, fabric.stack.inside))
    lights = [fabric.stack.lights[i] for i in training_lights(fabric.stack)]
    priors = under_priors.learn(samples, regions, lobes, options.threads)
    for light, factor in zip(lights, priors.lights, strict=True):
        if factor < 1:
            log.info("light %s: does not fit in with its neighbours; weight %.2g", light.name, factor)
    if priors.outliers:
        log.info("some samples are outliers: the fit takes Huber's loss")
    priors.write(out, lights)
