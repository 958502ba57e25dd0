"""Baselines beside a material: fitted to the training lights, judged on others, in some texels of a large fabric."""

from pathlib import Path

import numpy as np
import pytest

from kinran.base import frames
from kinran.data.fabric import Fabric
from kinran.data.held_out_photographs import HeldOut, survey
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.judge import simple_baselines
from kinran.judge.simple_baselines import SimpleBaselines

SHAPE = (20, 70)
"""Of a fabric of two tiles."""
LIGHTS = frames.direction(np.radians(20 + 10 * (np.arange(32) % 5)), np.radians(40.0 * np.arange(32)))


@pytest.fixture
def fabric(tmp_path: Path) -> Fabric:
    """Lambertian facets, but the photographs under the held-out lights are twice as bright."""
    slopes = np.random.default_rng(0).uniform(-0.2, 0.2, (*SHAPE, 2))
    factor = LIGHTS[:, 2, None, None] + np.einsum("yxk,lk->lyx", slopes, LIGHTS[:, :2])
    held = np.arange(32) % 4 == 1
    seen = 0.3 * factor[..., None].repeat(3, -1) * np.where(held, 2, 1)[:, None, None, None]
    write_shards(tmp_path / "radiance.zarr", 0, Radiance.unflagged(seen.astype(np.float32)))
    lights = tuple(Light(f"l{k}", tuple(d), held_out=bool(held[k])) for k, d in enumerate(LIGHTS.tolist()))
    metadata = Metadata(lights, *SHAPE, None, "", "", "camera", np.eye(3), {"kind": "photograph"})
    write_metadata(tmp_path / "radiance.zarr", metadata)
    labels, one = np.zeros(SHAPE, np.intp), np.ones(SHAPE, np.float32)
    write_labels(tmp_path / "labels.exr", labels, one, labels, one)
    write_regions(tmp_path / "regions.json", [Region(0, "silk", labels.size, (0.5, 0.5, 0.5), 1.0)])
    return Fabric(tmp_path)


def judged(fabric: Fabric) -> dict:
    """Errors beside a material that knows the held-out photographs."""
    seen = survey(fabric.stack)
    beside = SimpleBaselines(fabric, seen)
    for box in fabric.stack.tiles():
        held = HeldOut.read(fabric.stack, box, seen.peak)
        beside.add(box, held, held.truth)
    return beside.errors()


def test_baselines_see_the_training_lights_and_are_judged_on_the_others(fabric: Fabric) -> None:
    found = judged(fabric)
    assert (found["texels"], found["whole"]) == (1400, True)
    assert found["material"]["relative_error"] == 0
    assert found["baselines"].keys() == {"Lambert", "PTM", "HSH 9", "HSH 16"}
    assert found["baselines"]["Lambert"]["relative_error"] == pytest.approx(0.5, abs=0.001)


def test_a_large_fabric_is_judged_by_some_texels(fabric: Fabric, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simple_baselines, "SAMPLES", 24 * 200)
    found = judged(fabric)
    assert (found["texels"], found["whole"]) == (200, False)
    assert found["baselines"]["Lambert"]["relative_error"] == pytest.approx(0.5, abs=0.001)
