"""What methods see, and what they are judged by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trials import shiny_trial

from kinran.base import encoding
from kinran.base.files import InputError
from kinran.base.frames import direction
from kinran.compare import trial
from kinran.data.fabric import Fabric
from kinran.data.labels import Region, write_labels, write_regions
from kinran.data.radiance import HOT, SATURATED, Radiance
from kinran.data.radiance_stack import Light, Metadata, write_metadata, write_shards
from kinran.fit.samples import SATURATED_WEIGHT

NOISE = {
    "kind": "raw",
    "saturation_counts": 1000.0,
    "seconds": [0.01, 0.04],
    "white_counts_per_second": [1e5, 2e5, 1e5],
}


def fabric_of(
    folder: Path, held: tuple[int, ...], encoded: str = "", labels: np.ndarray | None = None, shared: bool = False
) -> Fabric:
    """A fabric of 6 × 10 texels under 8 lights: light k shows k + 1 (a tenth of it when encoded).

    Each texel is of one region, or shared with the next one.
    """
    lights = [Light(f"l{k}", tuple(direction(0.15 * k, 0.7 * k)), held_out=k in held) for k in range(8)]
    values = (np.arange(8, dtype=np.float32) + 1) * (0.1 if encoded else 1.0)
    radiance = np.broadcast_to(values[:, None, None, None], (8, 6, 10, 3)).astype(np.float32).copy()
    radiance[:, 0, 0] *= 0.5
    flags = np.zeros(radiance.shape, np.uint8)
    flags[7, 1, 1, 0], flags[0, 2, 2, 1], flags[3, 1, 1, 0] = SATURATED, HOT, SATURATED
    write_shards(folder / "radiance.zarr", 0, Radiance(radiance, flags))
    noise = {"kind": "photograph"} if encoded else NOISE
    metadata = Metadata(tuple(lights), 6, 10, None, encoded, "", "camera", np.eye(3), noise)
    write_metadata(folder / "radiance.zarr", metadata)
    labels = np.zeros((6, 10), np.intp) if labels is None else labels
    share = np.full(labels.shape, 0.5 if shared else 1.0, np.float32)
    write_labels(folder / "labels.exr", labels, np.ones_like(share), labels + shared, share)
    write_regions(folder / "regions.json", [Region(0, "gold", 60, (0.5, 0.5, 0.5), 1.0)])
    return Fabric(folder)


def test_training_and_held_out_lights_are_apart(tmp_path: Path) -> None:
    tried = trial.read(fabric_of(tmp_path, (2, 3)))
    assert tried.samples.T.shape == (60, 3, 6)
    np.testing.assert_allclose(tried.samples.T[7, 0], [1, 2, 5, 6, 7, 8])
    np.testing.assert_allclose(tried.truth[7, 0], [3, 4])
    assert tried.texels == 60
    assert [light.name for light in tried.lights] == ["l0", "l1", "l4", "l5", "l6", "l7"]
    np.testing.assert_array_equal(tried.share, 1)


def test_bad_samples_have_no_weight_and_do_not_judge(tmp_path: Path) -> None:
    tried = trial.read(fabric_of(tmp_path, (2, 3)))
    assert tried.samples.W[11].tolist() == [1, 1, 1, 1, 1, 0]  # light 7 is saturated at texel (1, 1)
    assert tried.samples.W[22].tolist() == [0, 1, 1, 1, 1, 1]  # light 0 has a defect at (2, 2)
    assert not tried.valid[11, 0, 1]
    assert tried.valid.sum() == tried.valid.size - 1


def test_photographs_are_judged_where_they_clip_and_weighted_by_their_encoding(tmp_path: Path) -> None:
    tried = trial.read(fabric_of(tmp_path, (3,), "srgb"))
    assert tried.valid.all()
    assert tried.clips == ()
    assert tried.samples.W[8, 0] > tried.samples.W[8, -1]
    assert tried.samples.W[11, -1] == pytest.approx(SATURATED_WEIGHT * tried.samples.W[12, -1])
    np.testing.assert_allclose(tried.decoded(tried.encoded().T), np.minimum(tried.samples.T, 1), atol=1e-5)


def test_the_middle_of_a_large_map_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "SIDE", 4)
    labels = np.arange(60).reshape(6, 10)
    tried = trial.read(fabric_of(tmp_path, (3,), labels=labels, shared=True))
    assert tried.shape == (4, 4)
    region = tried.samples.region
    np.testing.assert_array_equal(region.reshape(4, 4), labels[1:5, 3:7])
    np.testing.assert_array_equal(tried.samples.second, region + 1)
    np.testing.assert_array_equal(tried.thinned(3).samples.second, region[[0, 7, 15]] + 1)


def test_exposures_hold_radiance_up_to_the_clip_of_the_sensor(tmp_path: Path) -> None:
    tried = trial.read(fabric_of(tmp_path, (3,)))
    np.testing.assert_allclose(tried.clips, [[0.2475, 0.12375, 0.2475], [0.99, 0.495, 0.99]])
    one = tried.with_exposures(1)
    np.testing.assert_allclose(one.samples.T.max((0, 2)), [0.2475, 0.12375, 0.2475])
    assert (one.samples.W == 0).all()


def test_errors_in_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no light is held out"):
        trial.read(fabric_of(tmp_path / "a", ()))
    with pytest.raises(InputError, match="5 × 10 texels are not the 6 × 10 of the stack"):
        trial.read(fabric_of(tmp_path / "b", (3,), labels=np.zeros((5, 10), np.intp)))


def test_less_light_and_fewer_texels() -> None:
    tried = shiny_trial()
    few = tried.under(np.array([1, 5]))
    np.testing.assert_array_equal(few.samples.T, tried.samples.T[:, :, [1, 5]])
    assert few.lights == (tried.lights[1], tried.lights[5])
    np.testing.assert_array_equal(few.truth, tried.truth)
    thin = tried.thinned(10)
    assert thin.texels == len(thin.truth) == len(thin.samples.region) == len(thin.held.cell) == 10


def test_linear_light_goes_through_the_encoding() -> None:
    tried = replace(shiny_trial(), coder=encoding.parse("srgb"))
    assert tried.encoded().T.max() <= 1
    assert replace(tried, coder=None).encoded() is tried.samples
