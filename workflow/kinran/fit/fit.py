"""Fit a model to a run of tiles of the radiance stack."""

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from kinran.base.digest import digest
from kinran.base.files import InputError, atomic, sha256
from kinran.base.log import progress
from kinran.base.shared_results import made
from kinran.data.fabric import Fabric
from kinran.data.light import half_steps
from kinran.data.radiance_stack import Box
from kinran.fit import lambert, samples, slope, takeda, under_priors
from kinran.fit.finished_tiles import Finished, content_key
from kinran.fit.fitted_model import Channels, Mapped
from kinran.fit.lobed_regions import chosen_lobes, kind, lobed_labels
from kinran.fit.region_priors import Priors
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes

LEAST_SAMPLES = 4
"""Fewest usable samples of a texel that has a fit of its own; one on a defect of the sensor may have fewer. A choice:
the place of a lobe and the two colours take as many."""


@dataclass(frozen=True)
class Inputs:
    """Files that the stage reads."""

    fabric: Annotated[Path, "folder of the fabric: radiance.zarr, labels.exr, regions.json"]
    prior: Annotated[Path | None, "priors of the regions (.json), for the slope model"] = None
    need: Annotated[Path | None, "needs of a scene (.json), instead of --fitted"] = None
    choice: Annotated[Path | None, "lobes that `kinran choice` chose (.json), instead of --lobes and --tail"] = None


@dataclass(frozen=True)
class Options:
    """The model, and the texels that it is fitted to."""

    model: Annotated[str, "model of the material"] = "slope"
    lobes: Annotated[Literal[1, 2], "number of lobes of the slope model"] = 1
    tail: Annotated[Literal["gaussian", "ggx"], "tail of its lobes"] = "ggx"
    fitted: Annotated[tuple[int, ...] | None, "labels that get a lobe (default: all); the rest stay a texture"] = None
    tile: Annotated[str, "which run of tiles: INDEX/COUNT, from 0"] = "0/1"
    threads: Annotated[int, "threads of this machine"] = 1


def main(
    inputs: Inputs, out: Annotated[Path, "OUT", "parameters of the run's texels (.npz)"], options: Options = Options()
) -> None:
    """Fit the run and write its parameters, with the CPU seconds that they took.

    Each tile is kept when it is done: a run that was stopped goes on where it was.

    Raises
    ------
    InputError
        The model is unknown, `tile` is no run of tiles, or the priors are for another number of lobes.
    """
    fabric = Fabric(inputs.fabric)
    boxes = _share(fabric.stack.tiles(), options.tile)
    job = _Job.of(fabric, inputs, options)
    finished = Finished.of(out, job.key(inputs))
    job.warm_up()
    for box in progress(boxes, options.model, "tiles"):
        if not finished.has(box):
            job.finish(box, finished)
    _write(out, kind(job.model, job.lobes), [finished.read(box) for box in boxes], boxes)
    finished.clear()


@dataclass(frozen=True)
class _Job:
    """The model of a run, its priors, and the regions that get its lobes."""

    fabric: Fabric
    model: str
    lobes: Lobes
    lobed: list[int] | None
    priors: Priors | None
    threads: int

    @classmethod
    def of(cls, fabric: Fabric, inputs: Inputs, options: Options) -> "_Job":
        if options.model not in FITS:
            raise InputError(f"model {options.model}: is none of {', '.join(FITS)}")
        lobes = chosen_lobes(inputs.choice, options.tail, options.lobes)
        lobed = lobed_labels(fabric.labels, options.fitted, inputs.need, inputs.choice)
        priors = Priors.read(inputs.prior, fabric) if inputs.prior else None
        if priors and any(prior.lobes != lobes.count for prior in priors.regions):
            raise InputError(f"{inputs.prior}: is of another number of lobes than {lobes.count}; make it again")
        return cls(fabric, options.model, lobes, lobed, priors, options.threads)

    def key(self, inputs: Inputs) -> str:
        """Digest of all that the result of a tile depends on."""
        words = [str(value) for value in (self.model, self.lobes.count, self.lobes.tail, self.lobed)]
        files = [path for path in (self.fabric.labels_path, inputs.prior) if path]
        return content_key([digest("kinran.fit.fit"), *words], files, self.fabric.stack_path)

    def finish(self, box: Box, finished: Finished) -> None:
        """Fit a tile and keep its channels; or take them from where someone fitted it."""
        made(
            f"tiles of {kind(self.model, self.lobes)}",
            "kinran.fit.fit",
            lambda: (self.contents, box, self.model, self.lobes, self.lobed, self.priors),
            {"tile.npz": finished.path(box)},
            lambda: finished.keep(box, self.fit(box)),
        )

    @cached_property
    def contents(self) -> list[tuple[str, str]]:
        """Names and SHA-256 of the files of the stack, and of the label map."""
        stack = self.fabric.stack_path
        files = sorted(path for path in stack.rglob("*") if path.is_file())
        return [(str(path.relative_to(self.fabric.folder)), sha256(path)) for path in [*files, self.fabric.labels_path]]

    def fit(self, box: Box) -> Channels:
        """Channels (texel,) of a tile in single precision, and the CPU seconds that they took."""
        start = time.process_time()
        tile = samples.read_samples(self.fabric, box)
        if self.priors and (self.priors.lights < 1).any():
            tile = tile.weighed(self.priors.lights)
        reading = time.process_time() - start
        part = self._channels(tile)
        part["fit.valid"] = ((tile.W > 0).sum(1) >= LEAST_SAMPLES).astype(float)
        fitting = time.process_time() - start - reading
        costs = {"cpu_seconds": np.array(fitting), "read_seconds": np.array(reading)}
        return {**costs, **{name: values.astype(np.float32) for name, values in part.items()}}

    def _channels(self, tile: Samples) -> Channels:
        """Channels (texel,) in the stack's unit and colour space; 0 where a texel does not have the channel."""
        lobed = np.full(len(tile), True) if self.lobed is None else np.isin(tile.region, self.lobed)
        if lobed.all():
            return self._fitted(tile).channels()
        names = self._fitted(tile.of(slice(0, 0))).channels()
        channels: Channels = {name: np.zeros(len(tile)) for name in names}
        for at, fit in ((np.flatnonzero(lobed), self._fitted), (np.flatnonzero(~lobed), lambert.fit)):
            for name, values in fit(tile.of(at)).channels().items():
                channels[name][at] = values
        return channels

    def _fitted(self, tile: Samples) -> Mapped:
        """Fit the model to each texel."""
        return FITS[self.model](self, tile)

    def slope(self, tile: Samples) -> slope.SlopeFit:
        """Fit lobes by least squares or with robust weights, then again with saturated samples as bounds."""
        return under_priors.fit(tile, self.lobes, self.priors, self.threads)

    def four_steps(self, tile: Samples) -> takeda.TakedaFit:
        """Fit Eq. 3 by the four steps of the paper (Takeda2008, §3.2)."""
        return takeda.four_steps(tile, *half_steps(self.fabric.stack.lights))

    def diffuse(self, tile: Samples) -> lambert.LambertFit:
        """Fit the diffuse term alone."""
        return lambert.fit(tile)

    def warm_up(self) -> None:
        """Compile the kernels before the clock starts."""
        lights = np.array([[0.0, 0.0, 1.0], [0.5, 0.0, 0.75**0.5], [0.0, 0.5, 0.75**0.5]])
        self._fitted(Samples.far(np.ones((1, 3, 3), np.float32), np.ones((1, 3), np.float32), lights))
        one = np.ones((1, 1, 1, 3), np.float32)
        samples.texels_first(one, np.zeros(one.shape, np.uint8), np.ones(256, np.float32))


FITS: dict[str, Callable[[_Job, Samples], Mapped]] = {
    "slope": _Job.slope,
    "takeda2008": _Job.four_steps,
    "lambert": _Job.diffuse,
}


def _share(boxes: list[Box], tile: str) -> list[Box]:
    """Tiles of the run ``INDEX/COUNT``, from 0."""
    words = tile.split("/")
    index, count = (int(word) for word in words) if len(words) == 2 and "".join(words).isdecimal() else (0, 0)
    if not index < count:
        raise InputError(f"--tile {tile}: is no run of tiles; give INDEX/COUNT, such as 0/4 to 3/4")
    cuts = np.linspace(0, len(boxes), count + 1).round().astype(int)
    return boxes[cuts[index] : cuts[index + 1]]


def _write(out: Path, of: str, parts: list[dict[str, NDArray[np.floating]]], boxes: list[Box]) -> None:
    """Write the parameters of all tiles, one after the other, and the sums of their costs."""
    names = list(parts[0]) if parts else ["cpu_seconds", "read_seconds"]
    costs = {name: np.sum([part[name] for part in parts]) for name in names if "." not in name}
    arrays = {name: np.concatenate([part[name] for part in parts]) for name in names if "." in name}
    costs |= {
        "kind": np.array(of),
        "boxes": np.array(boxes, np.int64).reshape(-1, 4),
        "peak_mb": np.array(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }
    with atomic(out) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, **costs, **arrays)
