"""What methods see, and what they are judged by."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from trials import shiny_trial

from kinran import encoding
from kinran.chart import trial
from kinran.files import InputError
from kinran.frames import direction
from kinran.radiance.value import HOT, SATURATED, Radiance
from kinran.stack import Light, Metadata, Stack, write_metadata, write_shards

NOISE = {
    "kind": "raw",
    "saturation_counts": 1000.0,
    "seconds": [0.01, 0.04],
    "white_counts_per_second": [1e5, 2e5, 1e5],
}


def stack_of(folder: Path, held: tuple[int, ...], encoded: str = "") -> Stack:
    """A stack of 6 × 10 texels under 8 lights: light k shows k + 1 (a tenth of it when encoded)."""
    lights = tuple(Light(f"l{k}", tuple(direction(0.15 * k, 0.7 * k)), held_out=k in held) for k in range(8))
    values = (np.arange(8, dtype=np.float32) + 1) * (0.1 if encoded else 1.0)
    radiance = np.broadcast_to(values[:, None, None, None], (8, 6, 10, 3)).astype(np.float32).copy()
    radiance[:, 0, 0] *= 0.5
    flags = np.zeros(radiance.shape, np.uint8)
    flags[7, 1, 1, 0], flags[0, 2, 2, 1], flags[3, 1, 1, 0] = SATURATED, HOT, SATURATED
    write_shards(folder, 0, Radiance(radiance, flags))
    noise = {"kind": "photograph"} if encoded else NOISE
    write_metadata(folder, Metadata(lights, 6, 10, None, encoded, "", "camera", np.eye(3), noise))
    return Stack.open(folder)


def test_training_and_held_out_lights_are_apart(tmp_path: Path) -> None:
    tried = trial.read(stack_of(tmp_path / "s.zarr", (2, 3)), np.zeros((6, 10), np.intp), np.eye(3))
    assert tried.T.shape == (60, 3, 6)
    np.testing.assert_allclose(tried.T[7, 0], [1, 2, 5, 6, 7, 8])
    np.testing.assert_allclose(tried.truth[7, 0], [3, 4])
    assert tried.texels == 60
    assert tried.grid is None
    np.testing.assert_array_equal(tried.share, 1)


def test_bad_samples_have_no_weight_and_do_not_judge(tmp_path: Path) -> None:
    tried = trial.read(stack_of(tmp_path / "s.zarr", (2, 3)), np.zeros((6, 10), np.intp), np.eye(3))
    assert tried.W[11].tolist() == [1, 1, 1, 1, 1, 0]  # light 7 is saturated at texel (1, 1)
    assert tried.W[22].tolist() == [0, 1, 1, 1, 1, 1]  # light 0 has a defect at (2, 2)
    assert not tried.valid[11, 0, 1]
    assert tried.valid.sum() == tried.valid.size - 1


def test_photographs_are_judged_where_they_clip_and_weighted_by_their_encoding(tmp_path: Path) -> None:
    tried = trial.read(stack_of(tmp_path / "s.zarr", (3,), "srgb"), np.zeros((6, 10), np.intp), np.eye(3))
    assert tried.valid.all()
    assert tried.clips == ()
    assert tried.W[8, 0] > tried.W[8, -1]
    assert tried.W[11, -1] == pytest.approx(trial.SATURATED_WEIGHT * tried.W[12, -1])
    np.testing.assert_allclose(tried.decoded(tried.encoded()), np.minimum(tried.T, 1), atol=1e-5)


def test_the_middle_of_a_large_map_is_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "SIDE", 4)
    labels = np.arange(60).reshape(6, 10)
    tried = trial.read(stack_of(tmp_path / "s.zarr", (3,)), labels, np.eye(3), labels + 1)
    assert tried.shape == (4, 4)
    np.testing.assert_array_equal(tried.region.reshape(4, 4), labels[1:5, 3:7])
    np.testing.assert_array_equal(tried.second, tried.region + 1)
    np.testing.assert_array_equal(tried.thinned(3).second, tried.region[[0, 7, 15]] + 1)


def test_exposures_hold_radiance_up_to_the_clip_of_the_sensor(tmp_path: Path) -> None:
    tried = trial.read(stack_of(tmp_path / "s.zarr", (3,)), np.zeros((6, 10), np.intp), np.eye(3))
    np.testing.assert_allclose(tried.clips, [[0.2475, 0.12375, 0.2475], [0.99, 0.495, 0.99]])
    one = tried.with_exposures(1)
    np.testing.assert_allclose(one.T.max((0, 2)), [0.2475, 0.12375, 0.2475])
    assert (one.W == 0).all()


def test_errors_in_one_sentence(tmp_path: Path) -> None:
    stack = stack_of(tmp_path / "s.zarr", ())
    with pytest.raises(InputError, match="no light is held out"):
        trial.read(stack, np.zeros((6, 10), np.intp), np.eye(3))
    stack = stack_of(tmp_path / "t.zarr", (3,))
    with pytest.raises(InputError, match="not those of the label map"):
        trial.read(stack, np.zeros((5, 10), np.intp), np.eye(3))


def test_lights_that_lie_apart() -> None:
    lights = shiny_trial().lights
    few, more = trial.spread(lights, 8), trial.spread(lights, 16)
    assert set(few) <= set(more)
    assert len(set(more)) == 16
    s = lights[:, :2] / (1 + lights[:, 2:])

    def nearest(use: np.ndarray) -> float:
        distance = np.linalg.norm(s[use][:, None] - s[use], axis=-1) + 9 * np.eye(len(use))
        return float(distance.min())

    assert nearest(more) > nearest(np.arange(16))
    assert len(trial.spread(lights, 1000)) == len(lights)


def test_less_light_and_fewer_texels() -> None:
    tried = shiny_trial()
    few = tried.under(np.array([1, 5]))
    np.testing.assert_array_equal(few.T, tried.T[:, :, [1, 5]])
    np.testing.assert_array_equal(few.truth, tried.truth)
    thin = tried.thinned(10)
    assert thin.texels == len(thin.truth) == len(thin.region) == 10


def test_linear_light_goes_through_the_encoding() -> None:
    tried = replace(shiny_trial(), coder=encoding.parse("srgb"))
    assert tried.encoded().max() <= 1
    assert replace(tried, coder=None).encoded() is tried.T
