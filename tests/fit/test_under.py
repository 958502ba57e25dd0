"""Directions and falloff stay with their texels, however samples are read, taken apart and joined."""

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions
from hypothesis import given
from hypothesis import strategies as st
from synthetic_texels import grid

from kinran.base import distances
from kinran.data import texel_directions
from kinran.data.fabric import Fabric
from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples, read_samples, read_some

TEXELS, CELLS, LIGHTS = 40, 7, 5
HEIGHT, WIDTH, TEXEL_MM, DISTANCE = 70, 150, 0.4, 600.0

Seen = tuple[np.ndarray, np.ndarray, np.ndarray | None]


def some_under(seed: int = 0) -> Under:
    """Texels of cells with directions and falloff of their own."""
    rng = np.random.default_rng(seed)
    lights, slopes = rng.normal(size=(CELLS, LIGHTS, 3)), rng.normal(size=(CELLS, LIGHTS, 2))
    falloff = rng.uniform(0.5, 2, (TEXELS, LIGHTS)).astype(np.float32)
    return Under(rng.normal(size=(LIGHTS, 3)), lights, slopes, rng.integers(0, CELLS, TEXELS), falloff)


def by_texel(under: Under) -> Seen:
    """What each texel has: lights, slopes, falloff."""
    return under.lights[under.cell], under.slopes[under.cell], under.falloff


def assert_same(found: Under, lights: np.ndarray, slopes: np.ndarray, falloff: np.ndarray | None) -> None:
    for one, other in zip(by_texel(found), (lights, slopes, falloff), strict=True):
        np.testing.assert_array_equal(one, other)


@given(st.lists(st.integers(0, TEXELS - 1)))
def test_some_texels_keep_what_is_theirs(at: list[int]) -> None:
    """In any order, some more than once or none; no cell stays without texels."""
    under, index = some_under(), np.array(at, np.intp)
    some = under.of(index)
    assert_same(some, *(values[index] for values in by_texel(under)))
    assert len(some.lights) == len(np.unique(under.cell[index]))
    np.testing.assert_array_equal(some.directions, under.directions)


def test_a_mask_or_a_slice_names_texels_too() -> None:
    under = some_under()
    mask = np.arange(TEXELS) % 3 == 1
    for at in (mask, slice(1, None, 3)):
        assert_same(under.of(at), *(values[mask] for values in by_texel(under)))


def test_some_lights_of_every_texel() -> None:
    under, mask = some_under(), np.array([True, False, True, True, False])
    only = under.only(mask)
    assert_same(only, *(values[:, mask] for values in by_texel(under)))
    np.testing.assert_array_equal(only.directions, under.directions[mask])
    assert only.count == 3


def test_parts_joined_are_the_whole() -> None:
    under = some_under()
    cuts = [slice(0, 13), slice(13, 14), slice(14, TEXELS)]
    assert_same(texel_directions.join([under.of(at) for at in cuts]), *by_texel(under))


def test_far_parts_joined_are_one_cell() -> None:
    lights = grid(40, 3)
    joined = texel_directions.join([Under.far(lights, 3), Under.far(lights, 4)])
    assert len(joined.lights) == 1
    np.testing.assert_array_equal(joined.cell, np.zeros(7))


def test_cells_are_all_texels_once() -> None:
    under = some_under()
    places = [(k, at) for k, at in under.cells()]
    np.testing.assert_array_equal(np.sort(np.concatenate([at for _, at in places])), np.arange(TEXELS))
    assert all((under.cell[at] == k).all() for k, at in places)


def test_falloff_is_taken_out_and_put_back() -> None:
    under = some_under()
    T = np.random.default_rng(1).uniform(0.1, 1, (TEXELS, 3, LIGHTS)).astype(np.float32)
    np.testing.assert_allclose(under.square_on(under.reaching(T)), T, rtol=1e-6)
    far = Under.far(grid(40, 3), TEXELS)
    assert far.reaching(T) is T
    assert far.square_on(T) is T


@pytest.fixture(scope="module")
def fabric(tmp_path_factory: pytest.TempPathFactory) -> Fabric:
    """60 × 28 mm in six tiles, lamps and camera at 600 mm; noise, since only directions are looked at."""
    lights = grid(40, 4)
    radiance = np.random.default_rng(2).uniform(0.1, 1, (len(lights), HEIGHT, WIDTH, 3))
    labels = np.add.outer(np.zeros(HEIGHT, int), np.arange(WIDTH) // 50)
    folder = tmp_path_factory.mktemp("wide")
    Cloth(folder, radiance, directions(lights, DISTANCE, 4), labels, TEXEL_MM, (0, 0, DISTANCE))
    return Fabric(folder)


@pytest.fixture(scope="module")
def chosen() -> np.ndarray:
    """One texel of eleven, and none of the last tile."""
    mask = (np.arange(HEIGHT * WIDTH) % 11 == 4).reshape(HEIGHT, WIDTH)
    mask[64:, 128:] = False
    return mask


def test_texels_of_several_tiles_have_their_own_directions(fabric: Fabric, chosen: np.ndarray) -> None:
    """Half vectors are those at the middle of a cell of 1.2 mm, to 0.002; over the field they differ by 0.1."""
    some = read_some(fabric, chosen)
    lamps = [light.position_mm for light in fabric.stack.lights if light.position_mm and not light.held_out]
    points = _in_order_of_tiles(fabric, distances.texel_points(HEIGHT, WIDTH, TEXEL_MM))[
        _in_order_of_tiles(fabric, chosen)
    ]
    towards = np.stack([distances.directions_to(lamp, points) for lamp in lamps], 1)
    half = towards + distances.directions_to((0, 0, DISTANCE), points)[:, None]
    slopes = half[..., :2] / half[..., 2:]
    assert np.ptp(slopes, 0).max() > 0.09
    np.testing.assert_allclose(some.under.slopes[some.under.cell], slopes, atol=2e-3)
    np.testing.assert_allclose(some.under.lights[some.under.cell], towards, atol=2e-3)
    expected = np.stack([distances.falloff(lamp, points) for lamp in lamps], 1)
    np.testing.assert_allclose(some.under.falloff, expected, rtol=1e-6)


def test_texels_read_together_are_those_of_their_tiles(fabric: Fabric, chosen: np.ndarray) -> None:
    some, start = read_some(fabric, chosen), 0
    assert len(fabric.stack.tiles()) == 6
    for box in fabric.stack.tiles():
        inside = np.flatnonzero(chosen[box[0] : box[1], box[2] : box[3]])
        part = some.of(slice(start, start + len(inside)))
        start += len(inside)
        assert_equal(part, read_samples(fabric, box).of(inside))
    assert start == len(some) == chosen.sum()


def assert_equal(one: Samples, other: Samples) -> None:
    assert_same(one.under, *by_texel(other.under))
    for name in ("T", "W", "region", "second"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_what_is_read_is_square_on(fabric: Fabric) -> None:
    """T times the lamps' falloff is what the stack holds."""
    tile = read_samples(fabric, (0, 64, 0, 64))
    stored = fabric.stack.read_tile(0, 64, 0, 64, lights=np.flatnonzero(~fabric.stack.held_out)).value
    assert tile.under.falloff is not None
    assert np.ptp(tile.under.falloff) > 0.05
    np.testing.assert_allclose(
        tile.under.reaching(tile.T), stored.reshape(len(stored), -1, 3).transpose(1, 2, 0), rtol=1e-6
    )


def _in_order_of_tiles(fabric: Fabric, values: np.ndarray) -> np.ndarray:
    """Values (texel, …) of (y, x, …), tile by tile."""
    cut = [values[y0:y1, x0:x1].reshape(-1, *values.shape[2:]) for y0, y1, x0, x1 in fabric.stack.tiles()]
    return np.concatenate(cut)
