"""A small stack on disk with its labels, and the stages of the fit run on it."""

from pathlib import Path

import numpy as np

from kinran.__main__ import main
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.fit.region_priors import Prior, Priors
from kinran_bsdf.material import Material, read_material


class Cloth:
    """A folder with a stack, labels and regions; `fit` makes a material of it."""

    def __init__(
        self,
        folder: Path,
        radiance: np.ndarray,
        lights: list[Light],
        labels: np.ndarray | None = None,
        texel_mm: float | None = None,
        camera_mm: tuple[float, float, float] | None = None,
    ) -> None:
        self.folder, self.stack = folder, folder / "radiance.zarr"
        height, width = radiance.shape[1:3]
        labels = np.zeros((height, width), np.intp) if labels is None else labels
        write_shards(self.stack, 0, Radiance.unflagged(radiance.astype(np.float32)))
        noise = {"kind": "none"}
        metadata = Metadata(tuple(lights), height, width, texel_mm, "", "", "camera", np.eye(3), noise, camera_mm)
        write_metadata(self.stack, metadata)
        one = np.ones((height, width), np.float32)
        write_labels(folder / "labels.exr", labels, one, labels, one)
        sizes = np.bincount(labels.ravel())
        regions = [Region(k, f"thread{k}", int(n), (0.5, 0.5, 0.5), 1.0) for k, n in enumerate(sizes)]
        write_regions(folder / "regions.json", regions)

    def run(self, stage: str, out: str, *options: object) -> int:
        """Exit status of a stage, run by its words."""
        return main([stage, *(str(word) for word in (self.folder / out, "--fabric", self.folder, *options))])

    def fit(self, *options: object, lobes: tuple[str, int] = ("ggx", 1), prior: bool = False) -> Material:
        """Material of the stack, by the stages of the pipeline."""
        kind = ["--lobes", lobes[1], "--tail", lobes[0]]
        given: list[object] = []
        if prior:
            assert self.run("prior", "prior.json", *kind) == 0
            given = ["--prior", self.folder / "prior.json"]
        assert self.run("fit", "run.npz", "--model", "slope", *kind, *given, *options) == 0
        summary = ["--runs", self.folder / "run.npz", "--summary", self.folder / "slope.json"]
        assert self.run("material", "slope.exr", "--model", "slope", *kind, *summary, *options) == 0
        return read_material(self.folder / "slope.exr")


def directions(lights: np.ndarray, distance_mm: float | None = None, every: int = 0) -> list[Light]:
    """Lights of a stack, every so many held out."""
    return [
        Light(
            f"l{k}",
            (float(x), float(y), float(z)),
            None if distance_mm is None else (distance_mm * x, distance_mm * y, distance_mm * z),
            None,
            bool(every and k % every == every // 2),
        )
        for k, (x, y, z) in enumerate(lights.tolist())
    ]


def pictures(T: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Samples (texel, 3, light) as pictures (light, y, x, 3)."""
    return T.transpose(2, 0, 1).reshape(T.shape[2], *shape, 3)


def no_prior(path: Path, size: int = 7, regions: int = 1) -> None:
    """Priors that say nothing."""
    Priors([Prior(np.zeros(size), 0.0)] * regions, np.ones(0, np.float32)).write(path, [])
