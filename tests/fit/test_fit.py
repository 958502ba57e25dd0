"""The stage `kinran fit`: a run that is stopped keeps its tiles, and what has no lobe is not fitted."""

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, no_prior, pictures
from synthetic_texels import grid, radiance, texels

from kinran.data.fabric import Fabric
from kinran.data.fit_runs import read_runs
from kinran.data.radiance_stack import Box
from kinran.fit import fit, samples, slope
from kinran.fit.samples import Samples

SHAPE = (130, 70)
TILES = 6
OPTIONS = ("--model", "slope")


@pytest.fixture
def cloth(tmp_path: Path) -> Cloth:
    shapes, colours = texels(SHAPE[0] * SHAPE[1])
    lights = grid(40, 6)
    labels = (np.arange(SHAPE[0] * SHAPE[1]) % 3 > 0).astype(np.intp).reshape(SHAPE)
    return Cloth(tmp_path, pictures(radiance(shapes, colours, lights), SHAPE), directions(lights), labels)


def result(cloth: Cloth, name: str) -> dict[str, np.ndarray]:
    with np.load(cloth.folder / name) as data:
        return {key: data[key] for key in data.files if "." in key}


def reading(monkeypatch: pytest.MonkeyPatch, stop_after: int = TILES) -> list[Box]:
    """Boxes that are read; after so many the run is stopped."""
    boxes: list[Box] = []
    read = samples.read_samples

    def counted(fabric: Fabric, box: Box) -> Samples:
        if len(boxes) == stop_after:
            raise KeyboardInterrupt
        boxes.append(box)
        return read(fabric, box)

    monkeypatch.setattr(samples, "read_samples", counted)
    return boxes


def test_a_stopped_run_goes_on_where_it_was(cloth: Cloth, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cloth.run("fit", "whole.npz", *OPTIONS) == 0
    with monkeypatch.context() as patch:
        reading(patch, stop_after=4)
        assert cloth.run("fit", "run.npz", *OPTIONS) == 130
    assert not (cloth.folder / "run.npz").exists()
    boxes = reading(monkeypatch)
    assert cloth.run("fit", "run.npz", *OPTIONS) == 0
    assert len(boxes) == TILES - 4
    whole, resumed = result(cloth, "whole.npz"), result(cloth, "run.npz")
    assert whole.keys() == resumed.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(resumed[name], values)
    assert not [path for path in cloth.folder.iterdir() if path.name.endswith(".tiles")]


def test_a_material_does_not_depend_on_how_its_texels_are_divided(cloth: Cloth) -> None:
    """To the last bit; how many runs there were is noted beside it, for as long as the settings are the same."""
    materials = []
    for count in (1, 3):
        runs = [f"{k}-of-{count}.npz" for k in range(count)]
        for k, run in enumerate(runs):
            assert cloth.run("fit", run, *OPTIONS, "--tile", f"{k}/{count}") == 0
        paths = [cloth.folder / run for run in runs]
        summary = ["--summary", cloth.folder / "slope.json", "--settings", "these"]
        assert cloth.run("material", "slope.exr", *OPTIONS, "--runs", *paths, *summary) == 0
        material = cloth.folder / "slope.exr"
        assert [read_runs(material, of, 7) for of in ("these", "others")] == [count, 7]
        materials.append(material.read_bytes())
    assert materials[0] == materials[1]


def test_tiles_of_another_fit_are_not_taken(cloth: Cloth, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        reading(patch, stop_after=4)
        assert cloth.run("fit", "run.npz", *OPTIONS) == 130
    boxes = reading(monkeypatch)
    assert cloth.run("fit", "run.npz", *OPTIONS, "--fitted", 0) == 0
    assert len(boxes) == TILES


def test_a_torn_tile_is_fitted_again(cloth: Cloth, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        reading(patch, stop_after=4)
        assert cloth.run("fit", "run.npz", *OPTIONS) == 130
    torn = next(cloth.folder.glob(".run.npz.tiles/*/0_0.npz"))
    torn.write_bytes(torn.read_bytes()[:1000])
    boxes = reading(monkeypatch)
    assert cloth.run("fit", "run.npz", *OPTIONS) == 0
    assert len(boxes) == TILES - 3


def test_regions_without_a_lobe_are_not_fitted(cloth: Cloth, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two thirds of the texels stay a texture: no lobe is fitted to them, and the others are as without them."""
    assert cloth.run("fit", "all.npz", *OPTIONS) == 0
    fitted, fit = [], slope.fit

    def counted(some: Samples, *rest: Any, **again: Any) -> slope.SlopeFit:
        fitted.append(0 if again else len(some))
        return fit(some, *rest, **again)

    monkeypatch.setattr(slope, "fit", counted)
    assert cloth.run("fit", "some.npz", *OPTIONS, "--fitted", 0) == 0
    assert sum(fitted) - 1 == -(-SHAPE[0] * SHAPE[1] // 3)  # and one to compile
    every, some = result(cloth, "all.npz"), result(cloth, "some.npz")
    assert every.keys() == some.keys()
    textures = some["lobe1.R"] == 0
    assert (~textures).sum() <= sum(fitted)
    np.testing.assert_allclose(some["lobe1.x"][~textures], every["lobe1.x"][~textures], rtol=1e-5)
    assert (some["lobe1.x"][textures] == 0).mean() > 0.99


def test_a_fit_job_does_not_load_the_renderer() -> None:
    """Mitsuba and Dr.Jit would take 70 MB of each job."""
    loaded = "import sys, kinran.fit.fit; print({'mitsuba', 'drjit', 'kinran_bsdf'} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", loaded], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


@pytest.fixture
def fitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Texels of each tile that is fitted and not taken from the shared folder."""
    shared, sizes, channels = tmp_path / "shared", [], fit._Job._channels

    def counted(job: fit._Job, tile: Samples) -> dict[str, np.ndarray]:
        sizes.append(len(tile))
        return channels(job, tile)

    shared.mkdir()
    monkeypatch.setenv("KINRAN_CACHE", str(shared))
    monkeypatch.setattr(fit._Job, "_channels", counted)
    return sizes


DIFFUSE = ("--model", "lambert")


def test_tiles_that_someone_fitted_are_taken(cloth: Cloth, fitted: list[int]) -> None:
    """In another folder, and divided among other jobs; with the same bytes, and what they took to fit."""
    assert cloth.run("fit", "run.npz", *DIFFUSE) == 0
    assert len(fitted) == TILES
    mine = dict(np.load(cloth.folder / "run.npz"))
    other = object.__new__(Cloth)
    other.folder = cloth.folder.parent / "yours"
    shutil.copytree(cloth.folder, other.folder, ignore=shutil.ignore_patterns("shared", "yours", "run.npz"))
    assert other.run("fit", "run.npz", *DIFFUSE) == 0
    for job in range(2):
        assert other.run("fit", f"{job}.npz", *DIFFUSE, "--tile", f"{job}/2") == 0
    assert len(fitted) == TILES
    yours = dict(np.load(other.folder / "run.npz"))
    assert yours.keys() == mine.keys()
    for name in mine.keys() - {"peak_mb"}:
        np.testing.assert_array_equal(yours[name], mine[name])
    halves = [np.load(other.folder / f"{job}.npz") for job in range(2)]
    np.testing.assert_array_equal(np.concatenate([half["diffuse.R"] for half in halves]), mine["diffuse.R"])


def test_tiles_of_another_stack_are_fitted(cloth: Cloth, fitted: list[int]) -> None:
    """At the same path too; and those of other labels, or in another way of fitting them."""
    assert cloth.run("fit", "run.npz", *DIFFUSE) == 0
    before = Fabric(cloth.folder)
    seen, lights = before.stack.read_tile(0, SHAPE[0], 0, SHAPE[1]).value, list(before.stack.lights)
    labels = before.labels.astype(np.intp)
    seen[3, 129, 69, 1] *= 1.01
    cloth = Cloth(cloth.folder, seen, lights, labels)
    assert cloth.run("fit", "run.npz", *DIFFUSE) == 0
    assert len(fitted) == 2 * TILES
    labels[0, 0] = 1
    cloth = Cloth(cloth.folder, seen, lights, labels)
    assert cloth.run("fit", "run.npz", *DIFFUSE) == 0
    assert len(fitted) == 3 * TILES
    priors = cloth.folder / "priors.json"
    no_prior(priors, 7, 2)
    for way in (("--fitted", 0), ("--prior", priors), ("--tail", "gaussian"), ("--model", "takeda2008")):
        fitted.clear()
        assert cloth.run("fit", "run.npz", *DIFFUSE, *way) == 0
        assert len(fitted) >= TILES, way
    lights[5] = replace(lights[5], grid=(1, 2))
    cloth = Cloth(cloth.folder, seen, lights, labels)
    fitted.clear()
    assert cloth.run("fit", "run.npz", *DIFFUSE) == 0
    assert len(fitted) == TILES
