"""The pipeline's stages on a folder that holds a radiance stack, for benchmarks that judge their results."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

from kinran.data.fabric import Fabric
from kinran.fit import fit, material, prior
from kinran.segment import segment


@contextmanager
def quiet() -> Iterator[None]:
    """Silence the messages of the stages."""
    logger = logging.getLogger("kinran")
    level = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(level)


def segmented(folder: Path) -> Fabric:
    """Segment a folder's stack, and return the fabric with its regions."""
    segment.main(folder)
    return Fabric(folder)


def fitted(folder: Path, count: Literal[1, 2], tail: Literal["gaussian", "ggx"]) -> None:
    """Fit so many lobes to a folder's fabric: ``prior.json``, ``slope.npz``, ``material.exr``, ``slope.json``."""
    known, run = folder / "prior.json", folder / "slope.npz"
    prior.main(prior.Inputs(folder), known, prior.Options(count, tail))
    fit.main(fit.Inputs(folder, known), run, fit.Options("slope", count, tail))
    out = material.Outputs(folder / "material.exr", folder / "slope.json")
    material.main(material.Inputs(folder, (run,)), out, material.Options("slope", count, tail))
